//! Flow fields, images and masks, and what can be said of them without knowing how they were made.
//!
//! Conventions, kept by every crate of the workspace: arrays are row-major; an integer coordinate is the centre
//! of a pixel; flow is in pixels, `u` to the right and `v` down, from frame 1 to frame 2, stored at frame 1's pixel.

mod estimator;
mod grid;
pub mod random;

pub use estimator::{EstimateError, FlowEstimator};
pub use grid::{FlowField, Image, Mask, Plane, SizeError};
