//! Training the Gaussians of an avatar on pictures.

mod adam;
mod checkpoint;
mod config;
mod density;
pub mod image_loss;
mod initial;
mod mcmc;
mod pose_adam;
mod presets;
mod regularizers;
mod run;
mod schedule;
mod score;
mod trainer;

pub use adam::{GaussianAdam, LearningRates, ParameterGradients};
pub use config::{ConfigError, TrainConfig};
pub use density::{DensityChange, DensityControl, DensityScene, DensityStatistics, Strategy, change_density};
pub use image_loss::ImageLoss;
pub use initial::{camera_extent, initial_gaussians, scene_extent};
pub use mcmc::Mcmc;
pub use pose_adam::{PoseAdam, PoseRates};
pub use presets::PRESETS;
pub use regularizers::{RegularizerValue, Regularizers};
pub use run::{
    IterationsRecord, LogRecord, RUN_NAME, RunError, RunEvent, RunOutcome, RunRecord, RunRequest, RunScores,
    ScoredSplit, ScoresRecord, read_run, run, run_of_avatar,
};
pub use schedule::RateSchedule;
pub use score::{CameraScore, Score, Scorer, SplitScore, ViewScore};
pub use trainer::{StepReport, TrainError, Trainer};
