use std::io;
use std::path::{Path, PathBuf};

use srflow_core::{excerpt, printable};

/// Why a file could not be read or written: the file, the field, what was expected, and what was found.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", printable(&.path.to_string_lossy()))]
pub struct FileError {
    pub path: PathBuf,
    #[source]
    pub problem: FileProblem,
}

impl FileError {
    /// Whether the file does not exist.
    pub fn is_not_found(&self) -> bool {
        matches!(&self.problem, FileProblem::Io { error, .. } if error.kind() == io::ErrorKind::NotFound)
    }
}

/// The problem of a file; see [`FileError`].
#[derive(Debug, thiserror::Error)]
pub enum FileProblem {
    /// The operating system reported an error.
    #[error("{doing}: {error}{}", advice(.error))]
    Io {
        doing: &'static str,
        #[source]
        error: io::Error,
    },
    /// The operating system reported an error for a path that the user chose.
    #[error("{doing}: {error}; {advice}")]
    Place {
        doing: &'static str,
        #[source]
        error: io::Error,
        /// Advice on the path.
        advice: &'static str,
    },
    /// A field of the file has an unexpected value.
    #[error("{field}: expected {expected}, found {}", excerpt(.found))]
    Field {
        /// Name of the field, e.g. `magic` or `file size`.
        field: &'static str,
        /// The expected value, and advice.
        expected: String,
        found: String,
    },
    /// A cell of a table has an unexpected value.
    #[error("row {row}, {}: expected {expected}, found `{}`", excerpt(.column), excerpt(.found))]
    Cell {
        /// Line of the file, from 1.
        row: usize,
        column: String,
        expected: String,
        found: String,
    },
    /// The format cannot represent the value of a pixel.
    #[error("pixel ({x}, {y}): expected {expected}, found {found}")]
    Pixel { x: usize, y: usize, expected: &'static str, found: String },
}

/// Advice for an operating system error, if it is not obvious.
fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; free some space or write to another disk, and run the command again"
        }
        _ => "",
    }
}

impl FileProblem {
    /// A field with an unexpected value.
    pub fn field(field: &'static str, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Field { field, expected: expected.into(), found: found.into() }
    }

    /// An error of the operating system while reading.
    pub fn reading(error: io::Error) -> Self {
        Self::Io { doing: "reading", error }
    }

    /// Adds the file's name.
    pub fn in_file(self, path: &Path) -> FileError {
        FileError { path: path.to_owned(), problem: self }
    }
}
