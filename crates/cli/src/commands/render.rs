use clap::Args;

use crate::Context;

/// Render a facial optical-flow dataset with exact flow from a head avatar
#[derive(Args)]
pub struct Render {}

/// Runs the command.
pub fn run(_args: Render, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow render` is not built yet")
}
