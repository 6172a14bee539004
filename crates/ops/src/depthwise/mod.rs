//! Depthwise 2D convolution of stride 1 with large kernels (SKFlow's 15x15 and 7x7), forward and backward, on NCHW
//! slices.
//!
//! One channel at a time: its zero-padded plane fits in cache, and a register tile of several output rows uses each loaded
//! vector of pixels once per row. [`crate::convolution::reference`] is the definition,
//! with as many groups as channels.

mod backward;
#[cfg(feature = "cube")]
pub(crate) mod cube;
mod forward;
pub mod tensor;

pub(crate) use backward::backward_input_with;
pub use backward::{depthwise_backward_input, depthwise_backward_weight};
pub use forward::depthwise;

#[cfg(test)]
pub(crate) mod tests;
