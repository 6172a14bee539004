//! Dense 2D convolution (cross-correlation, as in deep learning), forward and backward, on NCHW slices.
//!
//! There are four fast versions. A pointwise convolution is a matrix product. Small kernels of stride 1 with enough channels
//! use Winograd's algorithm, which needs a half to a quarter of the products. Other kernels are matrix products too, with the
//! right side built in pieces that stay in cache. Those with few output channels are summed directly: a register tile of 8
//! output channels by 3 vectors of pixels accumulates over all input channels and kernel taps, so 24 fused multiply-adds need
//! 11 loads; a zero-padded copy of the input, its columns split by their remainder modulo the stride, makes every load
//! contiguous. [`crate::convolution::reference`] is the definition.

use srflow_simd::{Activation, Isa, activate};

mod backward;
mod forward;
mod panels;
pub mod tensor;
mod weight_gradient;
mod winograd;

#[cfg(feature = "cube")]
pub(crate) use backward::as_convolution;
pub(crate) use backward::backward_input_packed;
use backward::pack_backward;
pub use backward::{conv2d_backward_bias, conv2d_backward_input};
pub use forward::conv2d;
use forward::pack;
pub(crate) use forward::{convolve_packed, possible};
pub use weight_gradient::conv2d_backward_weight;

/// Applied to a sum before it is stored: `activation(sum + bias + residual)`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Epilogue<'a> {
    /// One number per output channel.
    pub bias: Option<&'a [f32]>,
    /// One number per output element.
    pub residual: Option<&'a [f32]>,
    /// Applied last.
    pub activation: Activation,
}

impl Epilogue<'_> {
    /// Adds the residual to sums that are still in cache, and applies the activation. `row` starts at element `first` of the
    /// output.
    pub(crate) fn finish(&self, isa: Isa, first: usize, row: &mut [f32]) {
        let residual = self.residual.map(|residual| &residual[first..first + row.len()]);
        if residual.is_some() || self.activation != Activation::Identity {
            activate(isa, self.activation, residual, row);
        }
    }

    /// Panics when the length of a slice does not match.
    pub(crate) fn check(&self, channels: usize, len: usize) {
        if let Some(bias) = self.bias {
            assert_eq!(bias.len(), channels, "a bias for each output channel");
        }
        if let Some(residual) = self.residual {
            assert_eq!(residual.len(), len, "a residual for each output element");
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
