use clap::Args;

use crate::Context;

/// Estimate optical flow between frames
#[derive(Args)]
pub struct Flow {}

/// Runs the command.
pub fn run(_args: Flow, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow flow` is not built yet")
}
