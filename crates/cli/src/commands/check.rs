use clap::Args;

use crate::Context;

/// Open every file of a dataset and report what is wrong
#[derive(Args)]
pub struct Check {}

/// Runs the command.
pub fn run(_args: Check, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow check` is not built yet")
}
