//! Output shared by all commands: nothing is overwritten without `--force`, text files are written whole or not at all, and
//! tables look alike.

use std::ffi::OsStr;
use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, bail};
use serde::Serialize;
use srflow_core::{is_unprintable, printable};
use srflow_eval::{Table, TextStyle, joined, latex_file};

use crate::usage::wrong_usage;
use crate::video::is_video;

/// Fails on the first of these files that exists, unless `force` allows to overwrite it.
pub fn ensure_free(files: impl IntoIterator<Item: Into<PathBuf>>, force: bool) -> anyhow::Result<()> {
    match files.into_iter().map(Into::into).find(|file| !force && file.exists()) {
        Some(file) => bail!("{} exists; give --force to overwrite it, or another name", file.display()),
        None => Ok(()),
    }
}

/// Fails if a folder is requested under the name of a file.
pub fn ensure_folder(folder: &Path) -> anyhow::Result<()> {
    const EXTENSIONS: [&str; 16] = [
        "png", "jpg", "jpeg", "bmp", "ppm", "npy", "npz", "npz16", "flo", "flo5", "pfm", "csv", "json",
        "html", "txt", "zip",
    ];
    let extension = folder.extension().and_then(OsStr::to_str).unwrap_or_default();
    let like_file = EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(extension)) || is_video(folder);
    if like_file && !folder.is_dir() {
        wrong_usage!("{}: expected a folder to write into, found the name of a file", folder.display());
    }
    Ok(())
}

/// Fails unless the name ends in the extension of the format.
pub fn ensure_extension(file: &Path, extension: &str) -> anyhow::Result<()> {
    if !file.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        wrong_usage!("{}: this output is a .{extension} file: give it that extension", file.display());
    }
    Ok(())
}

/// Tables as one LaTeX file.
pub fn latex(tables: &[Table]) -> String {
    latex_file(tables.iter().map(|table| (table.title.clone(), table.latex())))
}

/// Prints tables, in colours if standard output is a terminal and `NO_COLOR` is unset (<https://no-color.org>).
pub fn print_tables(tables: &[Table]) -> anyhow::Result<()> {
    let colours = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    let style = if colours { TextStyle::Ansi } else { TextStyle::Plain };
    let text = joined(tables, |table| table.text(style));
    writeln!(io::stdout(), "{}", text.trim_end()).context(PRINTING)
}

const PRINTING: &str = "printing the result";

/// Prints a line to standard output; see `say!`. Control characters are escaped, since the text may come from files.
pub fn print_line(text: fmt::Arguments) -> anyhow::Result<()> {
    writeln!(io::stdout(), "{}", printable(&text.to_string())).context(PRINTING)
}

/// Prints a line to standard error; see `note!`. Errors are ignored: there is nowhere to report them.
pub fn print_note(text: fmt::Arguments) {
    _ = writeln!(io::stderr(), "{}", printable(&text.to_string()));
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
