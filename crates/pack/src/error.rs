use std::path::PathBuf;

use srflow_core::SettingError;
use srflow_fetch::FetchError;
use srflow_files::{FileError, FileProblem, LockError};

/// Why a file on disk or on the web could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// It does not have the expected content.
    #[error("{}: {reason}", .path.display())]
    Content { path: PathBuf, reason: String },
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Fetch(#[from] Box<FetchError>),
}

/// Errors of packing.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// A setting is out of range.
    #[error("{0}")]
    Setting(#[from] SettingError),
    /// The folder has something else in it.
    #[error("{}: {found}; choose another folder, or give `force` to delete it", .dir.display())]
    Occupied { dir: PathBuf, found: String },
    /// A flow cannot be packed as asked.
    #[error("{}: {problem}; choose another `flow`", .path.display())]
    Flow {
        path: PathBuf,
        #[source]
        problem: FileProblem,
    },
    /// Files of the dataset are missing.
    #[error("{}: {count} files of the dataset are missing:\n{listed}\nrun `{command}` again to complete it", .dir.display())]
    Incomplete { dir: PathBuf, count: usize, listed: String, command: &'static str },
    #[error(transparent)]
    Lock(#[from] LockError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Read(#[from] ReadError),
}
