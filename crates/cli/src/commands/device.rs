use clap::{Args, Subcommand};
use srflow::device::{DevicesJob, TimeNetworkJob, TimeRasterizerJob};

use crate::Context;
use crate::run::run as run_job;

/// List the devices of this machine, or time and check one
///
/// Without a subcommand: lists every device that this build supports and the drivers find.
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow device
  srflow device network raft --device vulkan --size 800x512
  srflow device rasterizer --device vulkan --against-cpu

tools/gpu/measure runs all of it and writes a report; see docs/guides/gpu.md.")]
pub struct DeviceArgs {
    #[command(subcommand)]
    action: Option<Action>,
}

#[derive(Subcommand)]
enum Action {
    Network(TimeNetworkJob),
    Rasterizer(TimeRasterizerJob),
}

pub fn run(args: DeviceArgs, context: &Context) -> anyhow::Result<()> {
    match args.action {
        None => run_job(&DevicesJob {}, context),
        Some(Action::Network(job)) => run_job(&job, context),
        Some(Action::Rasterizer(job)) => run_job(&job, context),
    }
}
