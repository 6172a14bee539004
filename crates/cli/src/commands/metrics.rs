use clap::Args;

use crate::Context;

/// Score one flow against the truth
#[derive(Args)]
pub struct Metrics {}

/// Runs the command.
pub fn run(_args: Metrics, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow metrics` is not built yet")
}
