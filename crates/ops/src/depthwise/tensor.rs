//! The depthwise convolution on tensors: [`depthwise`] with gradients.

use burn::tensor::Tensor;

use crate::conv2d::tensor::Conv2dOptions;
use crate::convolution::{Epilogue, Kernels, convolve};

/// Depthwise convolution of `input` (`[batch, channels, height, width]`) with `weight`
/// (`[channels, 1, kernel_height, kernel_width]`), with stride 1 and `padding` zeros above and below, left and right.
///
/// Panics when the sizes do not fit each other or the padding is not smaller than the kernel.
pub fn depthwise(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, padding: [usize; 2]) -> Tensor<4> {
    let [channels, inputs, height, width] = weight.dims();
    assert_eq!([channels, inputs], [input.dims()[1], 1], "depthwise: a kernel for each channel");
    let smaller = padding[0] < height && padding[1] < width;
    assert!(smaller, "depthwise: padding of {padding:?} smaller than the kernel of {height}x{width}");
    convolve(Kernels::Depthwise, input, weight, epilogue, Conv2dOptions::new([1, 1], padding))
}
