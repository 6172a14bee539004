//! Classical optical flow: Gunnar Farneback and TV-L1, with the parameters and the results of OpenCV.
//!
//! Both methods work on 8-bit luminance, as OpenCV's functions do. Results do not depend on the number of threads.

mod block;
mod farneback;
mod planar;
mod tvl1;

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
