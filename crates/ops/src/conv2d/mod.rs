//! Dense 2D convolution (cross-correlation, as in deep learning), forward and backward, on NCHW slices.
//!
//! There are four fast versions. A pointwise convolution is a product of matrices. Small kernels of stride 1 over enough
//! channels go Winograd's way, which needs a half to a quarter of the products. Others are a product of matrices too, whose
//! right side is made in pieces that stay in the cache. Those with few output channels are summed directly: a register tile of 8 output channels by 3 vectors of pixels is kept while all input channels and kernel
//! taps pass by, so that 24 fused multiply-adds need 11 loads; a copy of the input with its border of zeros, its columns
//! split by their remainder modulo the stride, makes every load contiguous. [`mod@reference`] is the definition.

use srflow_simd::{Activation, Isa, activate};

mod backward;
mod forward;
mod panels;
pub mod reference;
pub mod tensor;
mod weight_gradient;
mod winograd;

pub use backward::{conv2d_backward_bias, conv2d_backward_input};
pub use forward::conv2d;
pub use weight_gradient::conv2d_backward_weight;

/// Sizes of a convolution. Layouts: input `[batch, in_channels, height, width]`, weight
/// `[out_channels, in_channels, kernel_height, kernel_width]`, output `[batch, out_channels, out_height, out_width]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Conv2dShape {
    /// Images.
    pub batch: usize,
    /// Input channels.
    pub in_channels: usize,
    /// Output channels.
    pub out_channels: usize,
    /// Input height and width.
    pub input: [usize; 2],
    /// Kernel height and width.
    pub kernel: [usize; 2],
    /// Stride down and across.
    pub stride: [usize; 2],
    /// Zeros added above and below, left and right.
    pub padding: [usize; 2],
}

impl Conv2dShape {
    /// Output height and width; 0 where the kernel does not fit.
    pub fn output(&self) -> [usize; 2] {
        [0, 1].map(|i| {
            let padded = self.input[i] + 2 * self.padding[i];
            if padded < self.kernel[i] { 0 } else { (padded - self.kernel[i]) / self.stride[i] + 1 }
        })
    }

    /// Elements of the input.
    pub fn input_len(&self) -> usize {
        self.batch * self.in_channels * self.input[0] * self.input[1]
    }

    /// Elements of the weight.
    pub fn weight_len(&self) -> usize {
        self.out_channels * self.in_channels * self.taps()
    }

    /// Elements of the output.
    pub fn output_len(&self) -> usize {
        let [height, width] = self.output();
        self.batch * self.out_channels * height * width
    }

    fn taps(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }
}

/// What becomes of a sum before it is stored: `activation(sum + bias + residual)`.
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
    /// Adds the residual to sums that are still in the cache, and applies the activation. `row` starts at element
    /// `first` of the output.
    pub(crate) fn finish(&self, isa: Isa, first: usize, row: &mut [f32]) {
        let residual = self.residual.map(|residual| &residual[first..first + row.len()]);
        if residual.is_some() || self.activation != Activation::Identity {
            activate(isa, self.activation, residual, row);
        }
    }

    /// Panics when a slice does not fit.
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
