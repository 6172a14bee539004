use std::path::{Path, PathBuf};

use srflow_field::FileError;

use super::frames::MissingFrames;
use crate::flow::DatasetError;

/// Why a micro-expression dataset could not be read.
#[derive(Debug, thiserror::Error)]
pub enum MicroExpressionError {
    #[error("`{found}`: expected KIND:DIR, e.g. samm:/data/SAMM. Kinds: {known}")]
    NotKindAndFolder {
        found: String,
        /// The kinds there are.
        known: String,
    },
    /// No annotation file fits.
    #[error("{kind}: looked for {expected} in {}; {found}", .dir.display())]
    NoAnnotations {
        kind: &'static str,
        dir: PathBuf,
        /// What the file is.
        expected: &'static str,
        /// What there is instead, and what to do.
        found: String,
    },
    /// A spreadsheet or table cannot be read.
    #[error("{}: {reason}", .path.display())]
    Table {
        path: PathBuf,
        /// What was expected and found.
        reason: String,
    },
    /// The columns of a table are not those of this dataset.
    #[error("{}: expected {kind}'s columns ({expected}); {found}", .path.display())]
    Columns {
        path: PathBuf,
        kind: &'static str,
        expected: String,
        /// What there is instead, and what to do.
        found: String,
    },
    /// A row does not hold what it must.
    #[error("{}, row {row}: {reason}", .path.display())]
    Row {
        path: PathBuf,
        /// Number of the row in the file, from 1.
        row: usize,
        /// What was expected and found.
        reason: String,
    },
    /// Two rows name the same clip.
    #[error("{}: subject {subject}, clip {clip} is there twice; keep one of the rows", .path.display())]
    Twice { path: PathBuf, subject: String, clip: String },
    /// No clip belongs to any of the classes.
    #[error(
        "{dataset}: no clip belongs to one of the classes {classes}; its clips are labelled {found}. Give other --classes"
    )]
    NoClass {
        dataset: String,
        /// The classes' names.
        classes: String,
        /// The labels that there are.
        found: String,
    },
    /// No clip's folder lies where it should.
    #[error("{kind}: looked for {looked_for}; {found}")]
    NoFolders {
        kind: &'static str,
        /// The first clip's folder.
        looked_for: String,
        /// What there is instead, and what to do.
        found: String,
    },
    /// Frames are missing, and that was not allowed.
    #[error(
        "{dataset}: {frames} frames of {clips} clips are missing below {}:\n{listed}\ncopy them there, or go on without them with --allow-missing{key_frames}",
        .root.display()
    )]
    Missing {
        dataset: String,
        /// The folder of the subjects' folders.
        root: PathBuf,
        /// How many frames.
        frames: u64,
        /// Of how many clips.
        clips: usize,
        /// The first of them, one clip a line.
        listed: String,
        /// What to do when clips hold key frames alone.
        key_frames: &'static str,
    },
    /// Two datasets of one name.
    #[error("two datasets are called `{0}`; give each once, plain ones in folders of different names")]
    SameName(String),
    /// A folder could not be listed.
    #[error(transparent)]
    Folder(#[from] DatasetError),
    /// A file could not be written.
    #[error(transparent)]
    File(#[from] FileError),
}

impl MicroExpressionError {
    /// How many clips are named; the rest are counted.
    const NAMED: usize = 8;

    pub(super) fn missing(dataset: &str, root: &Path, missing: &[MissingFrames]) -> Self {
        let mut listed: Vec<String> =
            missing.iter().take(Self::NAMED).map(|clip| format!("  {clip}")).collect();
        if missing.len() > Self::NAMED {
            listed.push(format!("  and {} more clips", missing.len() - Self::NAMED));
        }
        Self::Missing {
            dataset: dataset.to_owned(),
            root: root.to_owned(),
            frames: missing.iter().map(MissingFrames::count).fold(0, u64::saturating_add),
            clips: missing.len(),
            listed: listed.join("\n"),
            key_frames: match missing.iter().any(|clip| clip.holds_key_frames) {
                true => "; for clips that hold onset, apex and offset alone, give --only-key-frames",
                false => "",
            },
        }
    }
}
