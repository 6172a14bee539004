//! Renders datasets: scenes with exact flow and labelled micro-expression clips, with statistics and a check.

pub mod camera;
pub mod check;
mod error;
pub mod generate;
pub mod job;
pub mod record;
pub mod statistics;
pub mod synth;

pub use error::RenderError;
