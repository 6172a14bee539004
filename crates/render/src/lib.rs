//! Renders datasets: scenes with exact flow, generic pairs, labelled micro-expression clips and captures by many cameras, with statistics and a
//! check; measures how exact a tracked mesh and the flow of a trained avatar are.

pub mod camera;
pub mod capture;
pub mod check;
mod error;
pub mod generate;
mod head;
pub mod job;
pub mod label_error;
pub mod merge;
pub mod mesh_error;
mod parts;
pub mod record;
mod recording;
pub mod shapes;
pub mod statistics;
pub mod synth;

pub use error::RenderError;

/// Clap's derives with the feature `clap`; otherwise derives that generate nothing.
pub(crate) mod clap {
    #[cfg(feature = "clap")]
    pub use ::clap::Args;
    #[cfg(not(feature = "clap"))]
    pub use srflow_no_clap::Args;
}
