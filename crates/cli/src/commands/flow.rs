use std::path::PathBuf;

use clap::Args;

use crate::Context;
use crate::methods::{self, Method, MethodParameters};

/// Estimate optical flow between frames
#[derive(Args)]
pub struct Flow {
    /// Two frames, or more, or a folder of them
    #[arg(required = true, value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// How to estimate the flow
    #[arg(long, value_enum)]
    method: Method,
    #[command(flatten)]
    parameters: MethodParameters,
}

/// Runs the command.
pub fn run(args: Flow, _context: &Context) -> anyhow::Result<()> {
    let _estimator = methods::estimator(args.method, &args.parameters)?;
    anyhow::bail!("`srflow flow` reads no {} frames yet", args.frames.len())
}
