//! Making datasets: scenes with exact flow, labelled micro-expression clips, their statistics and their check.

pub mod camera;
pub mod check;
mod error;
pub mod generate;
pub mod job;
pub mod record;
pub mod statistics;
pub mod synth;

pub use error::RenderError;
