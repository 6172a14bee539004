//! `srflow mer`: jobs of micro-expressions.

use clap::{Args, Subcommand};
use srflow::mer;

use crate::Context;
use crate::run::run as run_job;

/// Micro-expression recognition
#[derive(Args)]
pub struct Mer {
    #[command(subcommand)]
    command: MerCommand,
}

#[derive(Subcommand)]
enum MerCommand {
    Data(mer::data::DataJob),
    Synth(mer::synth::SynthJob),
    SynthLong(mer::synth_long::SynthLongJob),
    Apex(mer::apex::ApexJob),
    Spot(mer::spot::SpotJob),
    SpotScore(mer::spot_score::SpotScoreJob),
    Strain(mer::strain::StrainJob),
    Features(mer::features::FeaturesJob),
    Run(mer::run::RunJob),
    Predict(mer::predict::PredictJob),
    Tables(mer::tables::TablesJob),
}

pub fn run(args: Mer, context: &Context) -> anyhow::Result<()> {
    match args.command {
        MerCommand::Data(job) => run_job(&job, context),
        MerCommand::Synth(job) => run_job(&job, context),
        MerCommand::SynthLong(job) => run_job(&job, context),
        MerCommand::Apex(job) => run_job(&job, context),
        MerCommand::Spot(job) => run_job(&job, context),
        MerCommand::SpotScore(job) => run_job(&job, context),
        MerCommand::Strain(job) => run_job(&job, context),
        MerCommand::Features(job) => run_job(&job, context),
        MerCommand::Run(job) => run_job(&job, context),
        MerCommand::Predict(job) => run_job(&job, context),
        MerCommand::Tables(job) => run_job(&job, context),
    }
}
