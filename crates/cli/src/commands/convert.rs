use clap::Args;

use crate::Context;

/// Convert a flow between file formats, or draw it in colours
#[derive(Args)]
pub struct Convert {}

/// Runs the command.
pub fn run(_args: Convert, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow convert` is not built yet")
}
