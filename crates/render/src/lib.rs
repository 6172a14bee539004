//! Making datasets: scenes with exact flow, labelled micro-expression clips, their statistics and their check.

pub mod camera;
pub mod check;
pub mod generate;
pub mod record;
pub mod statistics;
pub mod synth;
