//! `srflow avatar`: head models and avatars.

use clap::{Args, Subcommand};
use srflow::avatar;

use crate::Context;
use crate::run::run as run_job;

/// Head models and avatars: from a video, captures, fitting, training, scores, meshes, landmarks, export, action units
#[derive(Args)]
pub struct Avatar {
    #[command(subcommand)]
    command: AvatarCommand,
}

#[derive(Subcommand)]
enum AvatarCommand {
    Capture(avatar::capture::CaptureJob),
    Eval(avatar::eval::EvalJob),
    Export(avatar::export::ExportJob),
    Fit(avatar::fit::FitJob),
    FromVideo(avatar::from_video::FromVideoJob),
    Import(avatar::import::ImportJob),
    Landmarks(avatar::landmarks::LandmarksJob),
    Mesh(avatar::mesh::MeshJob),
    Train(avatar::train::TrainJob),
    Units(avatar::units::UnitsJob),
}

pub fn run(args: Avatar, context: &Context) -> anyhow::Result<()> {
    match args.command {
        AvatarCommand::Capture(job) => run_job(&job, context),
        AvatarCommand::Eval(job) => run_job(&job, context),
        AvatarCommand::Export(job) => run_job(&job, context),
        AvatarCommand::Fit(job) => run_job(&job, context),
        AvatarCommand::FromVideo(job) => run_job(&job, context),
        AvatarCommand::Import(job) => run_job(&job, context),
        AvatarCommand::Landmarks(job) => run_job(&job, context),
        AvatarCommand::Mesh(job) => run_job(&job, context),
        AvatarCommand::Train(job) => run_job(&job, context),
        AvatarCommand::Units(job) => run_job(&job, context),
    }
}
