//! `srflow avatar`: head avatars, one file per subcommand.

mod capture;
mod fit;

use clap::{Args, Subcommand};

use crate::Context;

/// Head avatars: captures for training and tracking
#[derive(Args)]
pub struct Avatar {
    #[command(subcommand)]
    command: AvatarCommand,
}

#[derive(Subcommand)]
enum AvatarCommand {
    Capture(capture::Capture),
    Fit(fit::Fit),
}

pub fn run(args: Avatar, context: &Context) -> anyhow::Result<()> {
    match args.command {
        AvatarCommand::Capture(args) => capture::run(args, context),
        AvatarCommand::Fit(args) => fit::run(args, context),
    }
}
