//! What commands have in common when they write: nothing is overwritten unasked, texts are whole or absent, tables look
//! alike.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use srflow_eval::{Table, TextStyle, joined, latex_file};
use srflow_field::write_atomically;

/// Fails on the first of these files that exists, unless `force` allows to overwrite it.
pub fn ensure_free(files: impl IntoIterator<Item: Into<PathBuf>>, force: bool) -> anyhow::Result<()> {
    match files.into_iter().map(Into::into).find(|file| !force && file.exists()) {
        Some(file) => bail!("{} exists; give --force to overwrite it, or another name", file.display()),
        None => Ok(()),
    }
}

/// Writes a text file, whole or not at all.
pub fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    write_atomically(path, |file| file.write_all(text.as_bytes()))
        .with_context(|| format!("writing {}", path.display()))
}

/// Tables as one LaTeX file.
pub fn latex(tables: &[Table]) -> String {
    latex_file(tables.iter().map(|table| (table.title.clone(), table.latex())))
}

/// Prints tables, in colours where standard output is a terminal that wants them (<https://no-color.org>).
pub fn print_tables(tables: &[Table]) -> anyhow::Result<()> {
    let colours = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    let style = if colours { TextStyle::Ansi } else { TextStyle::Plain };
    say!("{}", joined(tables, |table| table.text(style)).trim_end())
}
