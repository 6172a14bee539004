//! Jobs of micro-expressions.

pub mod apex;
pub mod data;
pub mod features;
mod model;
pub mod predict;
mod preparation;
mod progress;
pub mod run;
mod sources;
pub mod spot;
pub mod spot_score;
pub mod strain;
pub mod synth;
pub mod synth_long;
pub mod tables;

pub use preparation::PreparationArgs;
pub use sources::SourceArgs;
