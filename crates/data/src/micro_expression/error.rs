use std::path::{Path, PathBuf};

use srflow_files::FileError;

use super::MissingFrames;

/// Errors of reading a micro-expression dataset.
#[derive(Debug, thiserror::Error)]
pub enum MicroExpressionError {
    #[error("`{found}`: expected KIND:DIR, e.g. samm:/data/SAMM. Kinds: {known}")]
    NotKindAndFolder { found: String, known: String },
    /// No annotation file was found.
    #[error("{kind}: looked for {expected} in {}; {found}", .dir.display())]
    NoAnnotations { kind: &'static str, dir: PathBuf, expected: &'static str, found: String },
    /// A spreadsheet or table cannot be read.
    #[error("{}: {reason}", .path.display())]
    Table { path: PathBuf, reason: String },
    /// A table has other columns than this dataset's.
    #[error("{}: expected {kind}'s columns ({expected}); {found}", .path.display())]
    Columns { path: PathBuf, kind: &'static str, expected: String, found: String },
    /// A row has an unexpected value.
    #[error("{}, row {row}: {reason}", .path.display())]
    Row {
        path: PathBuf,
        /// Row number in the file, from 1.
        row: usize,
        reason: String,
    },
    /// Two rows name the same clip.
    #[error("{}: subject {subject}, clip {clip} exists twice; keep one of the rows", .path.display())]
    Twice { path: PathBuf, subject: String, clip: String },
    /// No clip belongs to any of the classes.
    #[error(
        "{dataset}: no clip belongs to one of the classes {classes}; its clips are labelled {found}. Give other `classes`"
    )]
    NoClass { dataset: String, classes: String, found: String },
    /// No clip's folder was found.
    #[error("{kind}: looked for {looked_for}; {found}")]
    NoFolders { kind: &'static str, looked_for: String, found: String },
    /// Frames are missing, which was not allowed.
    #[error(
        "{dataset}: {frames} frames of {clips} clips are missing below {}:\n{listed}\n{advice}, or continue without them with `allow_missing`{key_frames}",
        .root.display()
    )]
    Missing {
        dataset: String,
        root: PathBuf,
        frames: u64,
        clips: usize,
        listed: String,
        /// Where to get the frames.
        advice: &'static str,
        /// Advice for clips that consist of key frames alone.
        key_frames: &'static str,
    },
    /// Two datasets have the same name.
    #[error("two datasets have the name `{0}`; give each once, and plain ones in folders of different names")]
    SameName(String),
    /// A file or folder could not be read, or a file not written.
    #[error(transparent)]
    File(#[from] FileError),
}

impl MicroExpressionError {
    /// How many clips are listed; the rest are counted.
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
            advice: match missing.iter().all(|clip| clip.unread.is_some()) {
                true => "convert the files that are there",
                false => "copy them there",
            },
            key_frames: match missing.iter().any(|clip| clip.holds_key_frames) {
                true => "; for clips with only onset, apex and offset, give `only_key_frames`",
                false => "",
            },
        }
    }
}
