//! The `srflow` command, for the binary and the Python package. Arguments, progress bars and reports live here; algorithms live in
//! the libraries.

#![warn(clippy::print_stdout, clippy::print_stderr)]

/// `println!` for results as text: a closed or full standard output is an error, not a panic.
macro_rules! say {
    ($($text:tt)*) => { crate::output::print_line(format_args!($($text)*)) };
}

/// `eprintln!` for progress, notes and errors: a closed or full standard error is ignored.
macro_rules! note {
    ($($text:tt)*) => { crate::output::print_note(format_args!($($text)*)) };
}

mod commands;
mod face;
mod interrupt;
mod job_engine;
mod large_frames;
mod library;
mod machine;
mod made;
mod methods;
mod networks;
mod opening;
mod output;
mod posed_head;
mod progress;
mod ranks;
mod rendering;
mod scoring;
mod usage;
mod video;

use std::ffi::OsString;
use std::io::{self, Write};

use clap::{Args, CommandFactory, Parser, Subcommand};

pub use commands::render::render;
pub use commands::train::train;
pub use face::FACE_MODELS_VARIABLE;
pub use library::Watch;
pub use methods::estimator_of;
pub use usage::UsageError;

/// Exit codes; see the help of the command.
const FAILED: u8 = 1;
const WRONG_USAGE: u8 = 2;
/// EX_TEMPFAIL of sysexits.h: job engines can be configured to run the command again.
const STOPPED: u8 = 75;

/// Render facial optical-flow datasets from avatars of 3D Gaussians; estimate, train and score optical flow.
#[derive(Parser)]
#[command(version, propagate_version = true, arg_required_else_help = true)]
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
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::Demo),
    Render(commands::render::Render),
    Shapes(commands::shapes::Shapes),
    Pack(commands::pack::Pack),
    Avatar(commands::avatar::Avatar),
    Flow(commands::flow::Flow),
    Train(commands::train::Train),
    Ablation(commands::ablation::Ablation),
    Eval(commands::eval::Eval),
    Figure(commands::figure::Figure),
    Mer(commands::mer::Mer),
    Metrics(commands::metrics::Metrics),
    Convert(commands::convert::Convert),
    Rasterize(commands::rasterize::Rasterize),
    Models(commands::models::Models),
    Device(commands::device::DeviceArgs),
    View(commands::view::View),
    Check(commands::check::Check),
    Merge(commands::merge::Merge),
}

/// All commands and options, as `--help` shows them.
pub fn command() -> clap::Command {
    Cli::command()
}

/// Runs the command with the arguments of a process, of which the first is its name, and returns its exit code.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let cli = match Cli::try_parse_from(&arguments) {
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
    if let Some(threads) = cli.context.threads.or_else(machine::threads_of_job)
        && let Err(error) = rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()
    {
        return fail(&anyhow::anyhow!("starting {threads} threads: {error}"), &cli.context);
    }
    let context = cli.context;
    let json = context.json;
    interrupt::watch(move |text| {
        note!("{text}");
        if json {
            output::print_error_json(text);
        }
    });
    let result: anyhow::Result<()> = match cli.command {
        Command::Demo(args) => commands::demo::run(args, &context),
        Command::Render(args) => commands::render::run(args, &context),
        Command::Shapes(args) => commands::shapes::run(args, &context),
        Command::Pack(args) => commands::pack::run(args, &context),
        Command::Avatar(args) => commands::avatar::run(args, &context),
        Command::Flow(args) => commands::flow::run(args, &context),
        Command::Train(args) => commands::train::run(args, &context),
        Command::Ablation(args) => commands::ablation::run(args, &context),
        Command::Eval(args) => commands::eval::run(args, &context),
        Command::Figure(args) => commands::figure::run(args, &context),
        Command::Mer(args) => commands::mer::run(args, &context),
        Command::Metrics(args) => commands::metrics::run(args, &context),
        Command::Convert(args) => commands::convert::run(args, &context),
        Command::Rasterize(args) => commands::rasterize::run(args, &context),
        Command::Models(args) => commands::models::run(args, &context),
        Command::Device(args) => commands::device::run(args, &context),
        Command::View(args) => commands::view::run(args, &context),
        Command::Check(args) => commands::check::run(args, &context),
        Command::Merge(args) => commands::merge::run(args, &context),
    };
    match result.and_then(|()| Ok(io::stdout().flush()?)) {
        Ok(()) => 0,
        // The reader has closed the pipe (`| head`).
        Err(error) if is_closed_pipe(&error) => FAILED,
        Err(error) => fail(&error, &context),
    }
}

/// Prints the error, with `--json` also to standard output.
fn fail(error: &anyhow::Error, context: &Context) -> u8 {
    let text = in_words(error);
    note!("error: {text}");
    if context.json {
        output::print_error_json(&text);
    }
    if error.is::<UsageError>() { WRONG_USAGE } else { FAILED }
}

/// The error and its causes; a cause that is already part of the text is not repeated.
pub fn in_words(error: &anyhow::Error) -> String {
    let mut words = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if !words.contains(&cause) {
            let colon = if words.is_empty() { "" } else { ": " };
            words.push_str(colon);
            words.push_str(&cause);
        }
    }
    words
}

fn is_closed_pipe(error: &anyhow::Error) -> bool {
    // Not the whole chain: a pipe that a file's error tells of is not standard output.
    let cause = error.downcast_ref::<io::Error>();
    cause.is_some_and(|cause| cause.kind() == io::ErrorKind::BrokenPipe)
}
