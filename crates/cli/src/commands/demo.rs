use clap::Args;

use crate::Context;

/// Make a small dataset, estimate its flow, score it and open it all in one report
#[derive(Args)]
pub struct Demo {}

/// Runs the command.
pub fn run(_args: Demo, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow demo` is not built yet")
}
