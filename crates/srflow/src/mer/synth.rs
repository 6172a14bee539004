//! Rendered micro-expression clips.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_render::synth::{SynthReport, SynthSettings, synthesize};

use crate::clap::Args;
use crate::output::write_line;
use crate::rendering::{Rendered, RenderingArgs};
use crate::{Job, Report, Watch, WhenStopped};

/// Render a labelled micro-expression dataset
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow mer synth --out synth
  srflow mer synth --out hard --subjects 30 --clips 9 --intensity 0.6 --noise 2 --drift 2
  srflow mer synth --out photos --head lam:anna.zip --head lam:ben.zip --subjects 2
  srflow mer data clips:synth

Along with the frames it writes the true flow from onset to apex (also that of the head and of the expression alone), the \
action units with their intensities, and the 68 landmarks of the onset. Running the same command again continues a stopped run.")]
pub struct SynthJob {
    /// Folder of the dataset
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    #[serde(flatten)]
    pub settings: SynthSettings,
    #[command(flatten)]
    #[serde(flatten)]
    pub rendering: RenderingArgs,
}

impl Job for SynthJob {
    const NAME: &'static str = "mer synth";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = SynthMade;

    fn work(&self, watch: &Watch) -> anyhow::Result<SynthMade> {
        let make = |request: srflow_render::job::Request| synthesize(&self.settings, request);
        let rendered = self.rendering.make(&self.out, "clips", watch, make)?;
        Ok(SynthMade { out: self.out.clone(), rendered })
    }
}

/// What a run of [`SynthJob`] has made.
#[derive(Debug, Clone, Serialize)]
pub struct SynthMade {
    #[serde(skip)]
    out: PathBuf,
    #[serde(flatten)]
    rendered: Rendered<SynthReport>,
}

impl Report for SynthMade {
    fn stopped(&self) -> bool {
        self.rendered.report.stopped
    }
}

impl fmt::Display for SynthMade {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let report = &self.rendered.report;
        let SynthReport { clips, made, subjects, classes, seconds, .. } = report;
        writeln!(f, "{made} of {clips} clips rendered in {seconds:.1} s")?;
        let (Some(frames), Some(mean_flow)) = (report.frames, report.mean_flow) else {
            return if report.stopped { Ok(()) } else { self.rendered.write_part(f, "the tables") };
        };
        let classes: Vec<String> = classes.iter().map(|(class, clips)| format!("{clips} {class}")).collect();
        writeln!(f, "{subjects} subjects, {frames} frames, {}", classes.join(", "))?;
        writeln!(f, "true flow from onset to apex: {mean_flow:.3} px on average on the head")?;
        write_line(f, format_args!("read it with clips:{}", self.out.display()))
    }
}
