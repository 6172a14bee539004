use std::io;
use std::path::{Path, PathBuf};

use crate::{excerpt, printable};

/// Why a file could not be read or written: which file, which of its fields, what was expected and what was found.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", printable(&.path.to_string_lossy()))]
pub struct FileError {
    pub path: PathBuf,
    pub problem: FileProblem,
}

impl FileError {
    /// Whether there is no such file.
    pub fn is_not_found(&self) -> bool {
        matches!(&self.problem, FileProblem::Io { error, .. } if error.kind() == io::ErrorKind::NotFound)
    }
}

/// What is wrong with a file; see [`FileError`].
#[derive(Debug, thiserror::Error)]
pub enum FileProblem {
    /// The operating system refused.
    #[error("{doing}: {error}{}", advice(.error))]
    Io {
        /// What was being done, e.g. `opening`.
        doing: &'static str,
        error: io::Error,
    },
    /// The operating system refused to put something there.
    #[error("{doing}: {error}; {advice}")]
    Place {
        /// What was being done, e.g. `creating`.
        doing: &'static str,
        error: io::Error,
        /// What path to give instead.
        advice: &'static str,
    },
    /// A field of the file does not hold what it must.
    #[error("{field}: expected {expected}, found {}", excerpt(.found))]
    Field {
        /// Name of the field, e.g. `magic` or `file size`.
        field: &'static str,
        /// What the field must hold, and what to do when it does not.
        expected: String,
        found: String,
    },
    /// The value of one pixel cannot stand in the file.
    #[error("pixel ({x}, {y}): expected {expected}, found {found}")]
    Pixel {
        /// Column and row.
        x: usize,
        y: usize,
        expected: &'static str,
        found: String,
    },
}

/// What to do about what the system says, where it does not go without saying.
fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; free some space or write to another disk, and run the command again"
        }
        _ => "",
    }
}

impl FileProblem {
    pub(crate) fn field(field: &'static str, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Field { field, expected: expected.into(), found: found.into() }
    }

    pub(crate) fn reading(error: io::Error) -> Self {
        Self::Io { doing: "reading", error }
    }

    /// The same problem, with the file's name.
    pub(crate) fn in_file(self, path: &Path) -> FileError {
        FileError { path: path.to_owned(), problem: self }
    }
}
