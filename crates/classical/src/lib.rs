//! Classical optical flow: Gunnar Farneback and TV-L1, with the parameters and the results of OpenCV.
//!
//! Both methods work on 8-bit luminance, as OpenCV's functions do. Results do not depend on the number of threads.

mod farneback;
mod planar;
mod tvl1;

use srflow_field::{EstimateError, FlowField, Image};

pub use farneback::{Farneback, FarnebackParameters};
pub use tvl1::{TvL1, TvL1Parameters};

/// A parameter is out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{method}: {parameter} must be {expected}, not {found}")]
pub struct ParameterError {
    /// Name of the method.
    pub method: &'static str,
    /// Name of the parameter, as OpenCV spells it.
    pub parameter: &'static str,
    /// The allowed values.
    pub expected: &'static str,
    /// The value found.
    pub found: f64,
}

/// Refuses frames, or an initial flow, of different sizes.
fn check_sizes(frame1: &Image, frame2: &Image, initial: Option<&FlowField>) -> Result<(), EstimateError> {
    let first = frame1.size();
    let others = [Some(frame2.size()), initial.map(FlowField::size)];
    match others.into_iter().flatten().find(|size| *size != first) {
        Some(second) => Err(EstimateError::SizeMismatch { first, second }),
        None => Ok(()),
    }
}
