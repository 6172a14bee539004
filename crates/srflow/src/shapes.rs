//! Datasets of generic pairs with exact flow and occlusion.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_render::shapes::{ShapesReport, ShapesSettings, shapes};

use crate::clap::Args;
use crate::output::write_line;
use crate::rendering::{Rendered, RenderingArgs};
use crate::{Job, Report, Watch, WhenStopped};

/// Render a dataset of generic pairs with exact flow and occlusion, to start training from
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow shapes --out shapes --pairs 2000
  srflow shapes --out subpixel --pairs 2000 --motion 0.05,1
  srflow train --config cpu-small --data chairs:shapes --out runs/start

Running the same command again continues a stopped run. The files have the layout of FlyingChairs, which other programs read too.")]
pub struct ShapesJob {
    /// Folder of the dataset
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    #[serde(flatten)]
    pub settings: ShapesSettings,
    #[command(flatten)]
    #[serde(flatten)]
    pub rendering: RenderingArgs,
}

impl Job for ShapesJob {
    const NAME: &'static str = "shapes";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = ShapesMade;

    fn work(&self, watch: &Watch) -> anyhow::Result<ShapesMade> {
        let rendered =
            self.rendering.make(&self.out, "pairs", watch, |request| shapes(&self.settings, request))?;
        Ok(ShapesMade { out: self.out.clone(), rendered })
    }
}

/// What a run of [`ShapesJob`] has made.
#[derive(Debug, Clone, Serialize)]
pub struct ShapesMade {
    #[serde(skip)]
    out: PathBuf,
    #[serde(flatten)]
    rendered: Rendered<ShapesReport>,
}

impl Report for ShapesMade {
    fn stopped(&self) -> bool {
        self.rendered.report.stopped
    }
}

impl fmt::Display for ShapesMade {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let ShapesReport { pairs, made, bytes, seconds, stopped, is_whole } = self.rendered.report;
        let per_minute = if made == 0 { 0.0 } else { 60.0 * made as f64 / seconds };
        let megabytes = bytes as f64 / 1e6;
        writeln!(
            f,
            "{made} of {pairs} pairs made in {seconds:.1} s: {per_minute:.0} pairs a minute, {megabytes:.1} MB"
        )?;
        if is_whole {
            write_line(f, format_args!("read it with chairs:{}", self.out.display()))
        } else if stopped {
            Ok(())
        } else {
            self.rendered.write_part(f, "the list of the splits")
        }
    }
}
