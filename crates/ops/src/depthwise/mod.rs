//! Depthwise 2D convolution of stride 1 with large kernels (SKFlow's 15x15 and 7x7), forward and backward, on NCHW
//! slices.
//!
//! One channel at a time: its plane with a border of zeros fits the cache, and a register tile of several output rows
//! uses each loaded vector of pixels once for each of them. [`mod@reference`] is the definition.

mod backward;
mod forward;
pub mod reference;
pub mod tensor;

pub use backward::{depthwise_backward_input, depthwise_backward_weight};
pub use forward::depthwise;

/// Sizes of a depthwise convolution. Layouts: input `[batch, channels, height, width]`, weight
/// `[channels, 1, kernel_height, kernel_width]`, output `[batch, channels, out_height, out_width]`. The gradient of the
/// bias is [`crate::conv2d::conv2d_backward_bias`]'s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DepthwiseShape {
    /// Images.
    pub batch: usize,
    /// Channels, of input and output.
    pub channels: usize,
    /// Input height and width.
    pub input: [usize; 2],
    /// Kernel height and width.
    pub kernel: [usize; 2],
    /// Zeros added above and below, left and right.
    pub padding: [usize; 2],
}

impl DepthwiseShape {
    /// Output height and width; 0 where the kernel does not fit.
    pub fn output(&self) -> [usize; 2] {
        [0, 1].map(|i| (self.input[i] + 2 * self.padding[i] + 1).saturating_sub(self.kernel[i]))
    }

    /// Elements of the input.
    pub fn input_len(&self) -> usize {
        self.batch * self.channels * self.input[0] * self.input[1]
    }

    /// Elements of the weight.
    pub fn weight_len(&self) -> usize {
        self.channels * self.kernel[0] * self.kernel[1]
    }

    /// Elements of the output.
    pub fn output_len(&self) -> usize {
        let [height, width] = self.output();
        self.batch * self.channels * height * width
    }
}

#[cfg(test)]
pub(crate) mod tests;
