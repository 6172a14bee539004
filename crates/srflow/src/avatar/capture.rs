//! Captures of a moving head by many cameras.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_render::capture::{CaptureReport, CaptureSettings, capture};

use crate::clap::Args;
use crate::rendering::{Rendered, RenderingArgs};
use crate::{Job, Report, Watch, WhenStopped};

/// Render a moving head for many cameras, in the files that VHAP exports and GaussianAvatars is trained on
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow avatar capture --out capture
  srflow avatar capture --out hard --noise 1 --calibration-noise 1 --landmark-noise 1.5
  srflow avatar capture --out small --cameras 4 --timesteps 30 --size 220x320

The ground truth is written too: alpha, cameras, the parameters of the head and its landmarks. Running the same command again continues
a stopped run.")]
pub struct CaptureJob {
    /// Folder of the capture
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    #[serde(flatten)]
    pub settings: CaptureSettings,
    #[command(flatten)]
    #[serde(flatten)]
    pub rendering: RenderingArgs,
}

impl Job for CaptureJob {
    const NAME: &'static str = "avatar capture";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = Rendered<CaptureReport>;

    fn work(&self, watch: &Watch) -> anyhow::Result<Self::Report> {
        self.rendering.make(&self.out, "timesteps", watch, |request| capture(&self.settings, request))
    }
}

impl Report for Rendered<CaptureReport> {
    fn stopped(&self) -> bool {
        self.report.stopped
    }
}

impl fmt::Display for Rendered<CaptureReport> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let CaptureReport { timesteps, made, cameras, bytes, seconds, stopped, complete, .. } = &self.report;
        writeln!(
            f,
            "{made} of {timesteps} timesteps by {cameras} cameras rendered in {seconds:.1} s: {:.1} pictures a second, {:.1} MB",
            *made as f64 * *cameras as f64 / seconds.max(1e-9),
            *bytes as f64 / 1e6
        )?;
        if !complete && !stopped {
            writeln!(
                f,
                "This part is complete. Copy the parts together; `srflow avatar capture` with the same arguments and without --shard\n\
                 then writes transforms.json and the other files of the whole."
            )?;
        }
        Ok(())
    }
}
