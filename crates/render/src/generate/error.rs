use std::io;
use std::path::PathBuf;

use srflow_field::FileError;
use srflow_splat::RasterizeError;

use crate::record::RecordError;
use srflow_read::manifest::ManifestError;

/// Why a dataset could not be made, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// An argument is out of range.
    #[error("{argument} {found}: expected {expected}")]
    Argument {
        /// Its name on the command line.
        argument: &'static str,
        /// What was given.
        found: String,
        /// What can be given.
        expected: String,
    },
    /// A folder that an argument names cannot be read.
    #[error("{argument} {}: {error}; expected {expected}", .path.display())]
    Folder {
        /// The argument's name on the command line.
        argument: &'static str,
        /// The folder.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
        /// What the argument can be.
        expected: &'static str,
    },
    /// The output folder holds something else.
    #[error("{}: the folder is not empty and holds no dataset.json; choose a new or empty folder", .0.display())]
    NotADataset(PathBuf),
    /// The output folder holds a dataset that was made with other arguments.
    #[error(
        "{}: the dataset there was made with {field} {found}, asked for is {asked}; use the same arguments to go on, another folder, or --force to delete it and start anew",
        .path.display()
    )]
    OtherDataset {
        /// The output folder.
        path: PathBuf,
        /// The field of dataset.json that differs.
        field: String,
        /// Its value there.
        found: String,
        /// The value asked for.
        asked: String,
    },
    /// The output folder's `dataset.json` cannot be read.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The head could not be made.
    #[error("making the head of {scene}: {reason}")]
    Head {
        /// Name of the scene.
        scene: String,
        /// What went wrong.
        reason: String,
    },
    /// A background image could not be read, or another file not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// A file of the dataset could not be written.
    #[error(
        "{error}; {written} of {total} pairs are whole: free some space if the disk is full, and run the same command again to go on"
    )]
    Write {
        /// The file and what the system said.
        error: FileError,
        /// Pairs that are complete.
        written: u64,
        /// Pairs asked for.
        total: u64,
    },
    /// A folder of the dataset could not be made, listed or deleted.
    #[error("{}: {error}; a dataset needs a folder that can be made, read and written to", .path.display())]
    Io {
        /// The folder or file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// The record of a pair is broken.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The rasterizer refused a frame.
    #[error("{scene}, frame {frame}: {error}")]
    Rasterize {
        /// Name of the scene.
        scene: String,
        /// Number of the frame.
        frame: u32,
        /// What it said.
        error: RasterizeError,
    },
    /// The threads could not be started.
    #[error("starting {threads} threads: {reason}")]
    Threads {
        /// How many.
        threads: usize,
        /// What went wrong.
        reason: String,
    },
}
