//! Where results go: nothing is overwritten unless the job says so, and tables look alike.

use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::bail;
use srflow_core::printable;
use srflow_report::{Table, TextStyle, joined, latex_file};

use crate::error::wrong_settings;
use crate::video::is_video;

/// Fails on the first of these files that exists, unless `force` allows to overwrite it.
pub fn ensure_free(files: impl IntoIterator<Item: Into<PathBuf>>, force: bool) -> anyhow::Result<()> {
    match files.into_iter().map(Into::into).find(|file| !force && file.exists()) {
        Some(file) => bail!("{} exists; give `force` to overwrite it, or another name", file.display()),
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
        wrong_settings!("{}: expected a folder to write into, found the name of a file", folder.display());
    }
    Ok(())
}

/// Fails unless the name ends in the extension of the format.
pub fn ensure_extension(file: &Path, extension: &str) -> anyhow::Result<()> {
    if !file.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
        wrong_settings!("{}: this output is a .{extension} file: give it that extension", file.display());
    }
    Ok(())
}

/// Tables as one LaTeX file.
pub fn latex(tables: &[Table]) -> String {
    latex_file(tables.iter().map(|table| (table.title.clone(), table.latex())))
}

/// Writes tables as text, with colours for a terminal in the alternate form `{:#}`.
pub fn write_tables(f: &mut fmt::Formatter, tables: &[Table]) -> fmt::Result {
    let style = if f.alternate() { TextStyle::Ansi } else { TextStyle::Plain };
    writeln!(f, "{}", joined(tables, |table| table.text(style)).trim_end())
}

/// Writes where the report for a browser is, after an empty line.
pub fn write_page(f: &mut fmt::Formatter, page: &Path) -> fmt::Result {
    writeln!(f)?;
    write_line(f, format_args!("Report: {}", page.display()))
}

/// Writes one line. Control characters are escaped, line ends too: names may come from files.
pub fn write_line(f: &mut fmt::Formatter, line: fmt::Arguments) -> fmt::Result {
    writeln!(f, "{}", printable(&line.to_string()))
}
