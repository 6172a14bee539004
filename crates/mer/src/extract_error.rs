use std::path::PathBuf;

use srflow_core::{EstimateError, Size, printable};
use srflow_face::FaceError;
use srflow_files::FileError;

use crate::features::FeatureError;

/// Why the features of a clip could not be computed.
#[derive(Debug, thiserror::Error)]
#[error("{clip}: {problem}")]
pub struct ExtractError {
    /// The clip, as dataset/subject/clip.
    pub clip: String,
    pub problem: ExtractProblem,
}

#[derive(Debug, thiserror::Error)]
pub enum ExtractProblem {
    /// A request to stop came first.
    #[error("stopped on request")]
    Stopped,
    #[error("it has no apex frame; spot it (`apex` course) or give a list of apex frames")]
    NoApex,
    /// A required frame is missing.
    #[error("frame {0} is missing")]
    NoFrame(u64),
    /// A frame cannot be read, or the cache cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// A frame could not be cropped.
    #[error(transparent)]
    Face(#[from] FaceError),
    /// The face of the onset could not be found.
    #[error("{}: {error}", printable(&.onset.to_string_lossy()))]
    NoSingleFace {
        /// The onset's file.
        onset: PathBuf,
        #[source]
        error: FaceError,
    },
    /// The flow method failed.
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    /// The flow is not finite.
    #[error(transparent)]
    Features(#[from] FeatureError),
    #[error("{} is {onset_size} and {} {apex_size} (WIDTHxHEIGHT): expected frames of one size with at least one pixel", .onset.display(), .apex.display())]
    Sizes {
        /// The onset's file.
        onset: PathBuf,
        onset_size: Size,
        /// The apex's file.
        apex: PathBuf,
        apex_size: Size,
    },
}
