use clap::Args;

use crate::Context;

/// Score estimators over a dataset and print the table
#[derive(Args)]
pub struct Eval {}

/// Runs the command.
pub fn run(_args: Eval, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow eval` is not built yet")
}
