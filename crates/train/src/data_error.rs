use std::path::PathBuf;

use srflow_core::Size;
use srflow_data::flow::{DatasetError, MadeError};

use crate::augment::AugmentError;

#[derive(Debug, thiserror::Error)]
pub enum DataError {
    #[error(
        "data.train is empty: choose a dataset to train on, e.g. `data` srflow:DIR, or `data` folder:DIR for a plain folder \
         of pairs"
    )]
    NoData,
    #[error("{0}")]
    Dataset(#[from] DatasetError),
    #[error(
        "{dataset} in {}: none of its {pairs} pairs has a true flow to learn from; {advice}", .dir.display()
    )]
    NoTruth { dataset: String, dir: PathBuf, pairs: usize, advice: &'static str },
    #[error(
        "{dataset} in {}: no {frames} consecutive frames with a true flow for each pair (training.clip_frames); choose a \
         dataset of videos, or set training.clip_frames=2 to train on pairs", .dir.display()
    )]
    NoClip { dataset: String, dir: PathBuf, frames: usize },
    #[error(
        "{pair}: its frames are {frame}, less than half the crop of {crop} (WIDTHxHEIGHT); set data.crop (`crop`) to at most \
         the size of the frames"
    )]
    TooSmall { pair: String, frame: Size, crop: Size },
    #[error("`{data}`: {source}")]
    Made {
        /// As in `data.train`, e.g. `rendered:`, or a pair of it.
        data: String,
        source: MadeError,
    },
    #[error("{0}")]
    Settings(AugmentError),
    #[error("{pair}: {source}")]
    Augment { pair: String, source: AugmentError },
}
