//! Renders datasets: scenes with exact flow, generic pairs, labelled micro-expression clips and captures by many cameras, with statistics and a
//! check; measures how exact a tracked mesh and the flow of a trained avatar are.

mod action_units;
pub mod camera;
pub mod capture;
pub mod check;
mod clap;
mod distractors;
mod error;
mod flow_parts;
pub mod generate;
mod head;
pub mod job;
pub mod label_error;
pub mod long;
pub mod merge;
pub mod mesh_error;
mod parts;
pub mod record;
mod recording;
mod setting_files;
pub mod shapes;
pub mod statistics;
pub mod synth;

pub use distractors::Gestures;
pub use error::{RecordError, RenderError};
