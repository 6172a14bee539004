//! Trains optical flow networks: losses, the paper's regularizers for skin, trainer, exact resume, ablation.

pub mod ablation;
pub mod augment;
pub mod batch;
pub mod checkpoint;
pub mod config;
pub mod loss;
mod made;
#[cfg(feature = "mpi")]
pub mod mpi;
mod prefetch;
pub mod ranks;
mod recompute;
pub mod replica;
mod report;
mod run;
pub mod schedule;
mod tensorboard;
pub mod training_log;
pub mod training_set;
mod validation;

pub use report::report;
pub use run::{Event, Outcome, RunMode, Start, TrainError, Training, config_of_run, train};
pub use validation::ValidationError;
