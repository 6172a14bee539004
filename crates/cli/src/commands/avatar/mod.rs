//! `srflow avatar`: head models and avatars, one file per subcommand.

mod eval;

use clap::{Args, Subcommand};

use crate::Context;

/// Head models and avatars: captures, fitting, training, scores, meshes, export, action units
#[derive(Args)]
pub struct Avatar {
    #[command(subcommand)]
    command: AvatarCommand,
}

#[derive(Subcommand)]
enum AvatarCommand {
    Capture(srflow::avatar::capture::CaptureJob),
    Eval(eval::Eval),
    Export(srflow::avatar::export::ExportJob),
    Fit(srflow::avatar::fit::FitJob),
    Import(srflow::avatar::import::ImportJob),
    Mesh(srflow::avatar::mesh::MeshJob),
    Train(srflow::avatar::train::TrainJob),
    Units(srflow::avatar::units::UnitsJob),
}

pub fn run(args: Avatar, context: &Context) -> anyhow::Result<()> {
    match args.command {
        AvatarCommand::Capture(args) => crate::run::run(&args, context),
        AvatarCommand::Eval(args) => eval::run(args, context),
        AvatarCommand::Export(args) => crate::run::run(&args, context),
        AvatarCommand::Fit(args) => crate::run::run(&args, context),
        AvatarCommand::Import(args) => crate::run::run(&args, context),
        AvatarCommand::Mesh(args) => crate::run::run(&args, context),
        AvatarCommand::Train(args) => crate::run::run(&args, context),
        AvatarCommand::Units(args) => crate::run::run(&args, context),
    }
}
