//! The `srflow` command, for the binary and the Python package. Arguments, progress bars and reports live here; algorithms live in
//! the libraries.

#![warn(clippy::print_stdout, clippy::print_stderr)]

/// `eprintln!` for progress, notes and errors: a closed or full standard error is ignored.
macro_rules! note {
    ($($text:tt)*) => { crate::output::print_note(format_args!($($text)*)) };
}

mod commands;
mod interrupt;
mod notes;
mod output;
mod progress;
mod ranks;
mod run;
mod usage;

use std::ffi::OsString;
use std::io::{self, Write};

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use srflow::Job;

/// Exit codes; see the help of the command.
const FAILED: u8 = 1;
const WRONG_USAGE: u8 = 2;
/// EX_TEMPFAIL of sysexits.h: job engines can be configured to run the command again.
const STOPPED: u8 = 75;

/// Render facial optical-flow datasets from avatars of 3D Gaussians; estimate, train and score optical flow.
#[derive(Parser)]
#[command(name = "srflow", version, propagate_version = true, arg_required_else_help = true)]
#[command(after_help = "\
Exit codes: 0 success, 1 failure, 2 wrong usage, 75 stopped on request or by SIGTERM or SIGINT (run the command again to continue). With --json \
standard output holds one JSON value: the result, or {\"error\": \"...\"} on failure.")]
struct Cli {
    #[command(flatten)]
    context: Context,
    #[command(subcommand)]
    command: Command,
}

/// Arguments of every command.
#[derive(Args, Clone)]
pub(crate) struct Context {
    /// Print the result as JSON on standard output; on failure, an object with the key `error`
    #[arg(long, global = true)]
    pub json: bool,
    /// Number of threads (default: all cores, or as many as control groups or SLURM_CPUS_PER_TASK allow)
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// The long options of the command.
    #[arg(skip)]
    options: Vec<String>,
}

#[derive(Subcommand)]
enum Command {
    Demo(srflow::demo::DemoJob),
    Render(srflow::render::RenderJob),
    Shapes(srflow::shapes::ShapesJob),
    Pack(srflow::pack::PackJob),
    Avatar(commands::avatar::Avatar),
    Flow(srflow::flow::FlowJob),
    Face(srflow::face::FaceJob),
    Train(srflow::train::TrainJob),
    Ablation(srflow::ablation::AblationJob),
    Eval(srflow::eval::EvalJob),
    Figure(srflow::figure::FigureJob),
    Mer(commands::mer::Mer),
    Metrics(srflow::metrics::MetricsJob),
    Convert(srflow::convert::ConvertJob),
    Rasterize(srflow::rasterize::RasterizeJob),
    Models(commands::models::Models),
    Device(commands::device::DeviceArgs),
    View(srflow::view::ViewJob),
    Check(srflow::check::CheckJob),
    Merge(srflow::merge::MergeJob),
}

/// All commands and options, as `--help` shows them.
pub fn command() -> clap::Command {
    Cli::command()
}

/// Runs the command with the arguments of a process, of which the first is its name, and returns its exit code.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let cli = match parsed(&arguments) {
        Ok(cli) => cli,
        Err(error) => {
            _ = error.print();
            if error.use_stderr() && arguments.iter().any(|argument| argument == "--json") {
                let text = error.to_string();
                output::print_error_json(text.strip_prefix("error: ").unwrap_or(&text).trim_end());
            }
            return u8::try_from(error.exit_code()).unwrap_or(WRONG_USAGE);
        }
    };
    if let Some(threads) = cli.context.threads.or_else(srflow::threads_of_job)
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()
    {
        return fail(&anyhow::anyhow!("starting {threads} threads: {error}"), &cli.context);
    }
    let context = cli.context;
    notes::start(&context.options);
    let json = context.json;
    interrupt::watch(move |text| {
        note!("{text}");
        if json {
            output::print_error_json(text);
        }
    });
    let result: anyhow::Result<()> = match cli.command {
        Command::Demo(args) => run::run(&args, &context),
        Command::Render(args) => run::run(&args, &context),
        Command::Shapes(args) => run::run(&args, &context),
        Command::Pack(args) => run::run(&args, &context),
        Command::Avatar(args) => commands::avatar::run(args, &context),
        Command::Flow(args) => run::run(&args, &context),
        Command::Face(args) => run::run(&args, &context),
        Command::Train(args) => ranks::train(&args, &context),
        Command::Ablation(args) => run::run(&args, &context),
        Command::Eval(args) => run::run(&args, &context),
        Command::Figure(args) => run::run(&args, &context),
        Command::Mer(args) => commands::mer::run(args, &context),
        Command::Metrics(args) => run::run(&args, &context),
        Command::Convert(args) => run::run(&args, &context),
        Command::Rasterize(args) => run::run(&args, &context),
        Command::Models(args) => commands::models::run(args, &context),
        Command::Device(args) => commands::device::run(args, &context),
        Command::View(args) => run::run(&args, &context),
        Command::Check(args) => run::run(&args, &context),
        Command::Merge(args) => run::run(&args, &context),
    };
    match result.and_then(|()| Ok(io::stdout().flush()?)) {
        Ok(()) => 0,
        // The reader has closed the pipe (`| head`).
        Err(error) if is_closed_pipe(&error) => FAILED,
        Err(error) => fail(&error, &context),
    }
}

fn parsed(arguments: &[OsString]) -> Result<Cli, clap::Error> {
    let mut command = Cli::command();
    let matches = command.try_get_matches_from_mut(arguments)?;
    let path = usage::path(&matches);
    let mut cli = Cli::from_arg_matches(&matches)?;
    let options = usage::options(&command, &path);
    if let Some(defaults) = cli.command.preset_defaults() {
        let mut command = usage::with_defaults(Cli::command(), &path, &defaults);
        cli = Cli::from_arg_matches(&command.try_get_matches_from_mut(arguments)?)?;
    }
    cli.context.options = options;
    Ok(cli)
}

impl Command {
    /// The settings that a preset starts from, where one was chosen.
    fn preset_defaults(&self) -> Option<serde_json::Value> {
        match self {
            Self::Render(job) => job.preset_defaults(),
            _ => None,
        }
    }
}

/// Prints the error, with `--json` also to standard output.
fn fail(error: &anyhow::Error, context: &Context) -> u8 {
    let text = usage::in_options(error, &context.options);
    note!("error: {text}");
    if context.json {
        output::print_error_json(&text);
    }
    if usage::is_wrong_usage(error) { WRONG_USAGE } else { FAILED }
}

fn is_closed_pipe(error: &anyhow::Error) -> bool {
    // Not the whole chain: a pipe that a file's error tells of is not standard output.
    let cause = error.downcast_ref::<io::Error>();
    cause.is_some_and(|cause| cause.kind() == io::ErrorKind::BrokenPipe)
}
