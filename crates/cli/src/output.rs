//! Output shared by all commands: reports on standard output, notes on standard error.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use serde::Serialize;
use srflow_core::{is_unprintable, printable};

/// Whether standard output shows colours: it is a terminal and `NO_COLOR` is unset (<https://no-color.org>).
pub fn is_coloured() -> bool {
    io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none()
}

const PRINTING: &str = "printing the result";

/// Prints a line to standard error; see `note!`. Errors are ignored: there is nowhere to report them.
pub fn print_note(text: fmt::Arguments) {
    _ = writeln!(io::stderr(), "{}", printable(&text.to_string()));
}

/// Prints the text of a report, which ends its lines itself. Control characters are escaped except for line ends and colours.
pub fn print_text(text: &str) -> anyhow::Result<()> {
    let safe = text
        .split('\n')
        .map(|line| if is_coloured() { line.to_owned() } else { printable(line).to_string() });
    let safe = safe.collect::<Vec<_>>().join("\n");
    write!(io::stdout(), "{}{}", safe.trim_end(), if safe.trim_end().is_empty() { "" } else { "\n" })
        .context(PRINTING)
}

/// Whether a result was printed as JSON: there is only one.
static JSON_PRINTED: AtomicBool = AtomicBool::new(false);

/// Prints the result as JSON to standard output.
pub fn print_json(result: &impl Serialize) -> anyhow::Result<()> {
    print_json_text(&serde_json::to_string_pretty(result).context(PRINTING)?)
}

/// Prints the result as JSON in one line to standard output.
pub fn print_json_line(result: &impl Serialize) -> anyhow::Result<()> {
    print_json_text(&serde_json::to_string(result).context(PRINTING)?)
}

fn print_json_text(text: &str) -> anyhow::Result<()> {
    JSON_PRINTED.store(true, Ordering::Relaxed);
    let mut safe = String::with_capacity(text.len() + 1);
    for c in text.chars() {
        if is_unprintable(c) && c != '\n' {
            let mut units = [0; 2];
            c.encode_utf16(&mut units).iter().for_each(|unit| safe += &format!("\\u{unit:04x}"));
        } else {
            safe.push(c);
        }
    }
    writeln!(io::stdout(), "{safe}").context(PRINTING)
}

/// Ends the program after a run that was stopped on request.
///
/// # Errors
/// When standard output cannot be written to.
pub fn exit_stopped() -> anyhow::Result<()> {
    io::stdout().flush().context(PRINTING)?;
    std::process::exit(crate::STOPPED.into())
}

/// Prints `{"error": ...}`, unless a result was printed.
pub fn print_error_json(error: &str) {
    if !JSON_PRINTED.load(Ordering::Relaxed) {
        _ = print_json_line(&serde_json::json!({ "error": error }));
    }
}
