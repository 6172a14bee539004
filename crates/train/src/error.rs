use srflow_files::{FileError, RunFolderError};
use srflow_nn::WeightsError;
use srflow_ops::PrecisionError;

use crate::checkpoint::CheckpointError;
use crate::config::ConfigError;
use crate::data_error::DataError;
use crate::loss::LossError;
use crate::validation::ValidationError;

/// Errors that end a run, or keep it from starting.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Data(#[from] DataError),
    #[error(transparent)]
    Validation(#[from] ValidationError),
    #[error(transparent)]
    Weights(#[from] WeightsError),
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    #[error(transparent)]
    Loss(#[from] LossError),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error(
        "the loss or its gradients were not finite in {in_a_row} consecutive steps; the last one, step {step}, had the pairs\n  \
         {samples}\n{last_checkpoint}. Check these pairs, or lower training.learning_rate"
    )]
    NotFinite {
        /// The last of these steps, counted from 1.
        step: u64,
        in_a_row: u64,
        /// The first frames of its batch.
        samples: String,
        /// A sentence that names the last checkpoint.
        last_checkpoint: String,
    },
    #[error("training.precision: {0}")]
    Precision(#[from] PrecisionError),
    #[error("a thread that reads training pairs panicked; see its message above")]
    Worker,
    #[error(
        "training.batch is {batch}, for {ranks} ranks: each takes at least one sample of a batch; raise `batch`, or start fewer"
    )]
    TooManyRanks { batch: usize, ranks: usize },
    #[error("rank {rank} of {ranks}, counted from 0: {error}")]
    Rank {
        rank: usize,
        ranks: usize,
        #[source]
        error: Box<TrainError>,
    },
    /// Another rank than this one has failed, and says more.
    #[error("rank {rank} of {ranks}, counted from 0, has failed: {reason}")]
    OtherRank { rank: usize, ranks: usize, reason: String },
    #[error(
        "{what} of rank {rank} and of rank 0 differ; all ranks need the same srflow, the same arguments and the same files, so a \
         file system that they share"
    )]
    RanksDiffer { what: &'static str, rank: usize },
}
