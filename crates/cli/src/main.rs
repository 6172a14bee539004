//! The `srflow` command. Arguments, progress bars and reports live here; algorithms live in the libraries.

/// `println!` for results: standard output that is closed or full is an error, not a panic.
macro_rules! say {
    ($($text:tt)*) => { crate::print_line(format_args!($($text)*)) };
}

mod commands;
mod large_frames;
mod machine;
mod methods;
mod networks;
mod output;
mod scoring;
mod size;
mod usage;
mod video;

use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use anyhow::Context as _;
use clap::{Args, Parser, Subcommand};
use srflow_ops::ReusingAllocator;

#[global_allocator]
static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();

/// From a head avatar made of 3D Gaussians to a facial optical-flow dataset to evaluated flow.
#[derive(Parser)]
#[command(version, propagate_version = true, arg_required_else_help = true)]
struct Cli {
    #[command(flatten)]
    context: Context,
    #[command(subcommand)]
    command: Command,
}

/// What every command takes.
#[derive(Args, Clone)]
pub struct Context {
    /// Print the result as JSON on standard output
    #[arg(long, global = true)]
    pub json: bool,
    /// Number of threads (default: all cores)
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::Demo),
    Render(commands::render::Render),
    Flow(commands::flow::Flow),
    Train(commands::train::Train),
    Ablation(commands::ablation::Ablation),
    Eval(commands::eval::Eval),
    Mer(commands::mer::Mer),
    Metrics(commands::metrics::Metrics),
    Convert(commands::convert::Convert),
    Rasterize(commands::rasterize::Rasterize),
    Models(commands::models::Models),
    Check(commands::check::Check),
}

fn main() -> ExitCode {
    let cli = Cli::parse(); // exits with 2 on wrong usage
    if let Some(threads) = cli.context.threads
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()
    {
        eprintln!("error: starting {threads} threads: {error}");
        return ExitCode::FAILURE;
    }
    let result: anyhow::Result<()> = match cli.command {
        Command::Demo(args) => commands::demo::run(args, &cli.context),
        Command::Render(args) => commands::render::run(args, &cli.context),
        Command::Flow(args) => commands::flow::run(args, &cli.context),
        Command::Train(args) => commands::train::run(args, &cli.context),
        Command::Ablation(args) => commands::ablation::run(args, &cli.context),
        Command::Eval(args) => commands::eval::run(args, &cli.context),
        Command::Mer(args) => commands::mer::run(args, &cli.context),
        Command::Metrics(args) => commands::metrics::run(args, &cli.context),
        Command::Convert(args) => commands::convert::run(args, &cli.context),
        Command::Rasterize(args) => commands::rasterize::run(args, &cli.context),
        Command::Models(args) => commands::models::run(args, &cli.context),
        Command::Check(args) => commands::check::run(args, &cli.context),
    };
    match result.and_then(|()| Ok(io::stdout().flush()?)) {
        Ok(()) => ExitCode::SUCCESS,
        // The reader has seen enough (`| head`): nothing to tell it.
        Err(error) if is_closed_pipe(&error) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            if error.is::<usage::UsageError>() { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}

fn print_line(text: fmt::Arguments) -> anyhow::Result<()> {
    writeln!(io::stdout(), "{text}").context("printing the result")
}

fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let cause = error.root_cause().downcast_ref::<io::Error>();
    cause.is_some_and(|cause| cause.kind() == io::ErrorKind::BrokenPipe)
}
