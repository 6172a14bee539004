use std::path::PathBuf;

use srflow_field::FileError;

use super::Split;
use crate::manifest::ManifestError;

/// Why a dataset could not be opened or one of its pairs could not be read.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The text after `--dataset` is not `KIND:DIR`.
    #[error("`{found}`: expected KIND:DIR, e.g. sintel-clean:/data/Sintel. Kinds: {known}")]
    NotKindAndFolder {
        /// What was given.
        found: String,
        /// The kinds there are.
        known: String,
    },
    /// No dataset of that name, or an option that it does not have.
    #[error("dataset kind `{kind}`: {reason}")]
    UnknownKind {
        /// What was given.
        kind: String,
        /// What is wrong and what is known.
        reason: String,
    },
    /// The dataset has no such split.
    #[error("{kind} has no {split} split; it has: {available}")]
    NoSplit {
        /// Kind of dataset.
        kind: String,
        /// The split asked for.
        split: Split,
        /// The splits there are.
        available: String,
    },
    /// A folder or file that the layout needs is not there, or the folder holds none of the files looked for.
    #[error("{kind}: looked for {looked_for}, {found}{hint}")]
    NotThere {
        /// Kind of dataset.
        kind: String,
        /// The path or pattern looked for.
        looked_for: String,
        /// What there is instead.
        found: String,
        /// What to do, or nothing.
        hint: String,
    },
    /// Files without their counterparts: the dataset is half there.
    #[error("{kind} in {}: {count} {} not as the layout needs:\n{listed}", .dir.display(), if *.count == 1 { "thing is" } else { "things are" })]
    Incomplete {
        /// Kind of dataset.
        kind: String,
        dir: PathBuf,
        /// How many.
        count: usize,
        /// The first of them, one a line.
        listed: String,
    },
    /// A file or folder could not be opened.
    #[error("{}: {error}", .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// A text file does not say what its format needs.
    #[error("{}: {reason}", .path.display())]
    Format {
        path: PathBuf,
        /// What was expected and found.
        reason: String,
    },
    /// A file of a pair does not fit frame 1.
    #[error("{}: expected {}x{} (WIDTHxHEIGHT) to go with {}, found {}x{}", .path.display(), .expected.0, .expected.1,
        .frame.display(), .found.0, .found.1)]
    SizeMismatch {
        path: PathBuf,
        /// Its width and height.
        found: (usize, usize),
        /// The file of frame 1.
        frame: PathBuf,
        /// Width and height that the file must have.
        expected: (usize, usize),
    },
    /// A picture or flow could not be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// `dataset.json` of an SRFlow dataset could not be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
}
