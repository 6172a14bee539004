//! Rendered long videos.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_render::long::{EventCounts, LongReport, LongSettings, record};

use crate::clap::Args;
use crate::output::write_line;
use crate::rendering::{Rendered, RenderingArgs};
use crate::{Job, Report, Watch, WhenStopped};

/// Render long videos with micro- and macro-expressions, for spotting
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow mer synth-long --out long
  srflow mer synth-long --out calm --subjects 8 --minutes 2 --intensity 0.5 --speech 0 --blinks 0

Each subject has a folder of frames, s01/000001.png and so on. events.csv lists every expression with onset, apex and \
offset, disturbances.csv every blink and sentence. Running the same command again continues a stopped run.")]
pub struct SynthLongJob {
    /// Folder of the videos
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    #[serde(flatten)]
    pub settings: LongSettings,
    #[command(flatten)]
    #[serde(flatten)]
    pub rendering: RenderingArgs,
}

impl Job for SynthLongJob {
    const NAME: &'static str = "mer synth-long";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = SynthLongMade;

    fn work(&self, watch: &Watch) -> anyhow::Result<SynthLongMade> {
        let make = |request: srflow_render::job::Request| record(&self.settings, request);
        let rendered = self.rendering.make(&self.out, "pieces", watch, make)?;
        Ok(SynthLongMade { out: self.out.clone(), rendered })
    }
}

/// What a run of [`SynthLongJob`] has made.
#[derive(Debug, Clone, Serialize)]
pub struct SynthLongMade {
    #[serde(skip)]
    out: PathBuf,
    #[serde(flatten)]
    rendered: Rendered<LongReport>,
}

impl Report for SynthLongMade {
    fn stopped(&self) -> bool {
        self.rendered.report.stopped
    }
}

impl fmt::Display for SynthLongMade {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let LongReport { frames, made, videos, events, seconds, stopped } = &self.rendered.report;
        writeln!(f, "{made} of {frames} frames rendered in {seconds:.1} s")?;
        let Some(EventCounts { micro, macros }) = events else {
            return if *stopped { Ok(()) } else { self.rendered.write_part(f, "the tables") };
        };
        write_line(
            f,
            format_args!(
                "{videos} videos with {micro} micro- and {macros} macro-expressions: {}",
                self.out.join(srflow_render::long::EVENTS_NAME).display()
            ),
        )
    }
}
