//! `srflow mer`: micro-expression recognition, one file per subcommand.

mod apex;
mod data;
mod features;
mod preparation;
mod progress;
mod run;
mod sources;
mod strain;
mod tables;

use clap::{Args, Subcommand};

use crate::Context;

/// Micro-expression recognition
#[derive(Args)]
pub struct Mer {
    #[command(subcommand)]
    command: MerCommand,
}

#[derive(Subcommand)]
enum MerCommand {
    Data(data::Data),
    Synth(srflow::mer::synth::SynthJob),
    Apex(apex::Apex),
    Strain(strain::Strain),
    Features(features::Features),
    Run(run::Run),
    Tables(tables::Tables),
}

pub fn run(args: Mer, context: &Context) -> anyhow::Result<()> {
    match args.command {
        MerCommand::Data(args) => data::run(args, context),
        MerCommand::Synth(args) => crate::run::run(&args, context),
        MerCommand::Apex(args) => apex::run(args, context),
        MerCommand::Strain(args) => strain::run(args, context),
        MerCommand::Features(args) => features::run(args, context),
        MerCommand::Run(args) => run::run(args, context),
        MerCommand::Tables(args) => tables::run(args, context),
    }
}
