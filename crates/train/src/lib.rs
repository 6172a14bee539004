//! Trains optical flow networks: losses, the paper's regularizers for skin, trainer, exact resume, ablation.

pub mod ablation;
pub mod augment;
pub mod batch;
pub mod checkpoint;
pub mod config;
mod data_error;
mod error;
pub mod loss;
mod made;
#[cfg(feature = "mpi")]
pub mod mpi;
mod pass;
mod prefetch;
pub mod ranks;
mod recompute;
pub mod replica;
mod report;
mod run;
pub mod schedule;
mod starts;
mod tensorboard;
pub mod training_log;
pub mod training_set;
mod validation;

pub use data_error::DataError;
pub use error::TrainError;
pub use made::{OpenMade, only_files};
pub use pass::{BatchLosses, Pass, PassSettings};
pub use report::report;
pub use run::{Event, Outcome, Start, Training, config_of_run, train};
pub use validation::ValidationError;
