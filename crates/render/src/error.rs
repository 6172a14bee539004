use std::io;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use srflow_core::{SettingError, Size};
use srflow_data::manifest::ManifestError;
use srflow_data::micro_expression::MicroExpressionError;
use srflow_files::FileError;
use srflow_head::HeadModelError;
use srflow_splat::RasterizeError;

/// Checks a `size` against the shortest and the longest side, in pixels.
pub(crate) fn check_size(size: Size, sides: RangeInclusive<usize>) -> Result<(), RenderError> {
    let (low, high) = (sides.start(), sides.end());
    let expected = format!("{low}x{low} to {high}x{high} (WIDTHxHEIGHT)");
    require("size", size, expected, sides.contains(&size.width) && sides.contains(&size.height))
}

/// Checks that the value of a setting is `fine`.
pub(crate) fn require(
    field: &'static str,
    found: impl ToString,
    expected: impl Into<String>,
    fine: bool,
) -> Result<(), RenderError> {
    match fine {
        true => Ok(()),
        false => Err(SettingError { field, found: found.to_string(), expected: expected.into() }.into()),
    }
}

/// Refuses strengths of disturbances of a recording that are negative or too great.
pub(crate) fn require_strengths(strengths: &[(&'static str, f32)]) -> Result<(), RenderError> {
    strengths.iter().try_for_each(|&(field, found)| {
        let most = match field {
            "noise" => 50.0,
            "drift" | "lighting" => 20.0,
            "blinks" => 1.0,
            "glances" | "speech" | "nods" | "breathing" => 2.0,
            _ => unreachable!("{field} is no disturbance"),
        };
        require(field, found, format!("0 to {most}"), (0.0..=most).contains(&found))
    })
}

/// Whether a disturbance is left out; such strengths are not recorded, as in the datasets from before there were any.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
pub(crate) fn is_none(strength: &f32) -> bool {
    *strength == 0.0
}

/// A record could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}; delete the file and run `srflow render` again to rewrite it", .path.display())]
pub struct RecordError {
    pub path: PathBuf,
    pub reason: String,
}

/// Why a dataset could not be rendered or completed.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A setting is out of range.
    #[error("{0}")]
    Setting(#[from] SettingError),
    /// The file or folder of a setting cannot be read.
    #[error("`{field}` {}: {error}; expected {expected}", .path.display())]
    Folder {
        field: &'static str,
        path: PathBuf,
        #[source]
        error: io::Error,
        expected: &'static str,
    },
    #[error(
        "{}: expected a dataset of `srflow render`, `srflow shapes`, `srflow mer synth` or `srflow mer synth-long`, found no dataset.json, shapes.json, synth.json or long.json; \
         give the folder that one of these commands wrote",
        .0.display()
    )]
    NoDataset(PathBuf),
    #[error("{}: the folder is not empty and has no {manifest}; choose a new or empty folder", .path.display())]
    NotADataset { path: PathBuf, manifest: &'static str },
    #[error(
        "{}: the folder has a dataset with {field} {found}, requested is {asked}; use the same arguments to continue it, another folder, or `force` to delete it and start over",
        .path.display()
    )]
    OtherDataset { path: PathBuf, field: String, found: String, asked: String },
    #[error("{}: expected the file as srflow wrote it, found {reason}; restore it from a copy, or choose another folder", .path.display())]
    Malformed { path: PathBuf, reason: String },
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error("making the head of {who}: {reason}")]
    Head {
        /// Name of the scene or subject.
        who: String,
        reason: String,
    },
    /// The head has no such action unit.
    #[error(transparent)]
    Expression(#[from] HeadModelError),
    /// A file outside the units could not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    #[error(
        "{error}; {written} of {total} {units} are complete: free some space if the disk is full, and run the same command again to continue"
    )]
    Write {
        #[source]
        error: FileError,
        written: u64,
        total: u64,
        units: &'static str,
    },
    #[error("{}: {error}; a dataset needs a folder that can be created, read and written", .path.display())]
    Io {
        path: PathBuf,
        #[source]
        error: io::Error,
    },
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The table of clips could not be written.
    #[error(transparent)]
    Table(#[from] MicroExpressionError),
    #[error("{}: the true flow is not known: {reason}", .dir.display())]
    NoTruth { dir: PathBuf, reason: String },
    #[error("{frame}: {error}")]
    Rasterize { frame: String, error: RasterizeError },
    #[error("starting {threads} threads: {reason}")]
    Threads { threads: usize, reason: String },
}

impl RenderError {
    pub(crate) fn io(path: &Path, error: io::Error) -> Self {
        Self::Io { path: path.to_owned(), error }
    }
}
