//! Commands for programs that use this crate as a library: the options of the command line, progress as data, and a way to stop.

use std::ffi::OsString;

use clap::error::ErrorKind;
use clap::{Args, Parser};
use serde_json::Value;

use crate::usage::UsageError;

/// What a command that takes long reports, and asks.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Takes progress, an object with the keys `done` and `total`. Called from any thread.
    pub on_progress: &'a (dyn Fn(Value) + Sync),
    /// Whether to stop, so that the same command continues. Asked from any thread.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

/// The options of a command alone.
#[derive(Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Options<A: Args> {
    #[command(flatten)]
    arguments: A,
}

/// The arguments that these options describe, as in `--tile=auto`. `command` is the one whose help lists them.
///
/// # Errors
/// [`UsageError`] when there is no such option, one is missing, or its value is wrong.
pub fn parsed<A: Args>(command: &str, options: impl IntoIterator<Item = OsString>) -> anyhow::Result<A> {
    match Options::try_parse_from(options) {
        Ok(Options { arguments }) => Ok(arguments),
        Err(error) => Err(UsageError(in_short(&error, command)).into()),
    }
}

/// What is wrong, in one line and without the usage of a command.
fn in_short(error: &clap::Error, command: &str) -> String {
    let text = error.render().to_string();
    let text = text.split("\n\nUsage:").next().unwrap_or(&text);
    let text = text.split("\n\nFor more information").next().unwrap_or(text);
    let text = text.strip_prefix("error: ").unwrap_or(text).replace("\n\n  tip:", ";");
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    match error.kind() {
        ErrorKind::UnknownArgument => format!("{text}; `{command} --help` lists the options"),
        _ => text,
    }
}
