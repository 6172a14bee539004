use std::io;
use std::path::{Path, PathBuf};

use srflow_avatar::HeadModelError;
use srflow_field::FileError;
use srflow_read::manifest::ManifestError;
use srflow_read::micro_expression::MicroExpressionError;
use srflow_splat::RasterizeError;

use crate::record::RecordError;

/// Why a dataset could not be made, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// An argument is out of range.
    #[error("{argument} {found}: expected {expected}")]
    Argument {
        /// Its name on the command line.
        argument: &'static str,
        found: String,
        expected: String,
    },
    /// A folder that an argument names cannot be read.
    #[error("{argument} {}: {error}; expected {expected}", .path.display())]
    Folder {
        /// The argument's name on the command line.
        argument: &'static str,
        path: PathBuf,
        error: io::Error,
        expected: &'static str,
    },
    /// The output folder holds something else.
    #[error("{}: the folder is not empty and holds no {manifest}; choose a new or empty folder", .path.display())]
    NotADataset { path: PathBuf, manifest: &'static str },
    /// The output folder holds a dataset that was made with other arguments.
    #[error(
        "{}: the dataset there was made with {field} {found}, asked for is {asked}; use the same arguments to continue it, another folder, or --force to delete it and start over",
        .path.display()
    )]
    OtherDataset { path: PathBuf, field: String, found: String, asked: String },
    /// A file that an earlier run wrote cannot be understood.
    #[error("{}: expected what srflow wrote there, found {reason}; restore the file from a copy, or choose another folder", .path.display())]
    Malformed { path: PathBuf, reason: String },
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error("making the head of {who}: {reason}")]
    Head {
        /// Name of the scene or subject.
        who: String,
        reason: String,
    },
    /// The head cannot show an action unit.
    #[error(transparent)]
    Expression(#[from] HeadModelError),
    /// A file beside the units' own could not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// A unit's file could not be written.
    #[error(
        "{error}; {written} of {total} {units} are whole: free some space if the disk is full, and run the same command again to continue"
    )]
    Write { error: FileError, written: u64, total: u64, units: &'static str },
    /// A folder of the dataset could not be made, listed or deleted.
    #[error("{}: {error}; a dataset needs a folder that can be made, read and written to", .path.display())]
    Io { path: PathBuf, error: io::Error },
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The table of clips could not be written.
    #[error(transparent)]
    Table(#[from] MicroExpressionError),
    #[error("{frame}: {error}")]
    Rasterize {
        /// Names the frame.
        frame: String,
        error: RasterizeError,
    },
    #[error("starting {threads} threads: {reason}")]
    Threads { threads: usize, reason: String },
}

impl RenderError {
    pub(crate) fn io(path: &Path, error: io::Error) -> Self {
        Self::Io { path: path.to_owned(), error }
    }
}
