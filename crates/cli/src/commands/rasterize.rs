use clap::Args;

use crate::Context;

/// Rasterize a file of 3D Gaussians: colour, flow, alpha and depth
#[derive(Args)]
pub struct Rasterize {}

/// Runs the command.
pub fn run(_args: Rasterize, _context: &Context) -> anyhow::Result<()> {
    anyhow::bail!("`srflow rasterize` is not built yet")
}
