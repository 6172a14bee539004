//! Printing: reports on standard output, notes on standard error.

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

/// Prints the text of a report. Control characters are escaped except for line ends and colours, since the text may come from files.
pub fn print_text(text: &str) -> anyhow::Result<()> {
    let lines: Vec<String> = text.trim_end().split('\n').map(safe_line).collect();
    writeln!(io::stdout(), "{}", lines.join("\n")).context(PRINTING)
}

/// A line with its colours, which are `ESC [ numbers m`.
fn safe_line(line: &str) -> String {
    let mut pieces = line.split("\u{1b}[");
    let mut safe = printable(pieces.next().unwrap_or_default()).to_string();
    for piece in pieces {
        match piece.split_once('m') {
            Some((numbers, rest)) if numbers.chars().all(|c| c.is_ascii_digit() || c == ';') => {
                safe += &format!("\u{1b}[{numbers}m{}", printable(rest));
            }
            _ => safe += &printable(&format!("\u{1b}[{piece}")),
        }
    }
    safe
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_kept_and_other_control_characters_escaped() {
        assert_eq!(safe_line("\u{1b}[1;32mgood\u{1b}[0m"), "\u{1b}[1;32mgood\u{1b}[0m");
        let hostile = safe_line("a\u{1b}[2Jb\u{1b}]0;title\u{7}");
        assert!(!hostile.contains(['\u{1b}', '\u{7}']), "{hostile:?}");
    }
}
