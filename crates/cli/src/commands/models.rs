use clap::{Args, Subcommand};
use srflow::models::{ExportJob, InspectJob, ModelsJob};

use crate::Context;
use crate::run::run as run_job;

/// List the networks, inspect a file of weights, or export one
///
/// Without a subcommand: lists every network with its parameters, the multiple that frames are padded to, the iterations,
/// the licence of the authors' code, and the published weights.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow models
  srflow models inspect skflow-things.ckpt --json
  srflow models export runs/first/best.safetensors -o raft.ckpt")]
pub struct Models {
    #[command(subcommand)]
    action: Option<Action>,
}

#[derive(Subcommand)]
enum Action {
    Inspect(InspectJob),
    Export(ExportJob),
}

pub fn run(args: Models, context: &Context) -> anyhow::Result<()> {
    match args.action {
        None => run_job(&ModelsJob {}, context),
        Some(Action::Inspect(job)) => run_job(&job, context),
        Some(Action::Export(job)) => run_job(&job, context),
    }
}
