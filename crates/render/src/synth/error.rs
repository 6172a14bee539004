use std::io;
use std::path::PathBuf;

use srflow_avatar::{AvatarError, HeadModelError};
use srflow_field::FileError;
use srflow_splat::RasterizeError;

use srflow_read::micro_expression::MicroExpressionError;

/// Why a set of micro-expressions could not be made, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
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
    /// The output folder holds something else.
    #[error("{}: the folder is not empty and holds no synth.json; choose a new or empty folder", .0.display())]
    NotASet(PathBuf),
    /// The output folder holds a set that was made with other arguments.
    #[error("{}: the set there was made with other arguments ({differs}); use the same to go on, another folder, or --force to make it anew", .path.display())]
    OtherSet {
        /// The output folder.
        path: PathBuf,
        /// The first argument that differs, there and here.
        differs: String,
    },
    /// `synth.json` or a clip's record cannot be understood.
    #[error("{}: expected what `srflow mer synth` writes: {reason}; --force makes the set anew", .path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A folder could not be made, read or emptied.
    #[error("{}: {error}", .path.display())]
    Io {
        /// The folder or file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// A head could not be made.
    #[error("making the head of {subject}: {error}")]
    Head {
        /// Name of the subject.
        subject: String,
        /// What went wrong.
        error: AvatarError,
    },
    /// The head cannot show an action unit.
    #[error(transparent)]
    Expression(#[from] HeadModelError),
    /// The rasterizer refused a frame.
    #[error("{clip}: {error}")]
    Rasterize {
        /// Name of the clip.
        clip: String,
        /// What it said.
        error: RasterizeError,
    },
    /// A file could not be written.
    #[error("{0}; run the same command again to go on")]
    File(#[from] FileError),
    /// The table of clips could not be written.
    #[error(transparent)]
    Table(#[from] MicroExpressionError),
    /// The threads could not be started.
    #[error("starting {threads} threads: {reason}")]
    Threads {
        /// How many.
        threads: usize,
        /// What went wrong.
        reason: String,
    },
}
