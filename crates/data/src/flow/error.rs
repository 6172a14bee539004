use std::path::PathBuf;

use srflow_core::Size;
use srflow_files::FileError;
use srflow_pack::ReadError;

use super::split::Split;
use crate::manifest::ManifestError;
use crate::micro_expression::MicroExpressionError;

/// Why a dataset could not be opened, or one of its pairs could not be read.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The text after `--dataset` is not `KIND:DIR`.
    #[error("`{found}`: expected KIND:DIR, e.g. sintel-clean:/data/Sintel. Kinds: {known}")]
    NotKindAndFolder { found: String, known: String },
    /// Unknown kind of dataset, or an option that it does not have.
    #[error("dataset kind `{kind}`: {reason}")]
    UnknownKind { kind: String, reason: String },
    /// The dataset has no such split.
    #[error("{kind} has no {split} split; it has: {available}")]
    NoSplit { kind: String, split: Split, available: String },
    /// A folder or file required by the layout is missing, or no file matches a pattern.
    #[error("{kind}: looked for {looked_for}, {found}{hint}")]
    NotThere { kind: String, looked_for: String, found: String, hint: String },
    /// The dataset is incomplete: files without their counterparts.
    #[error("{kind} in {}: {count} {}:\n{listed}", .dir.display(), if *.count == 1 { "problem" } else { "problems" })]
    Incomplete { kind: String, dir: PathBuf, count: usize, listed: String },
    /// A text file does not have the expected format.
    #[error("{}: {reason}", .path.display())]
    Format { path: PathBuf, reason: String },
    /// A file of a pair has another size than frame 1.
    #[error("{}: expected {expected} (WIDTHxHEIGHT) to go with {}, found {found}", .path.display(), .frame.display())]
    SizeMismatch { path: PathBuf, found: Size, frame: PathBuf, expected: Size },
    /// A picture or flow could not be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// A part of a packed dataset could not be read.
    #[error(transparent)]
    Packed(#[from] ReadError),
    /// `dataset.json` of an SRFlow dataset could not be used.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The clips of a micro-expression dataset could not be read.
    #[error(transparent)]
    Clips(#[from] Box<MicroExpressionError>),
}
