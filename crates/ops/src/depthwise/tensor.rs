//! The depthwise convolution on tensors: [`depthwise`] with gradients.

use burn::tensor::Tensor;
use srflow_simd::Isa;

use super::backward::backward_input_with;
use super::depthwise_backward_weight;
use crate::conv2d;
use crate::convolution::{Conv2dShape, Convolution, Epilogue, convolve};
use crate::flex::CpuTensor;

#[derive(Debug, Clone)]
pub(super) struct Depthwise {
    pub(super) padding: [usize; 2],
}

impl Convolution for Depthwise {
    fn padding(&self) -> [usize; 2] {
        self.padding
    }

    fn forward(
        &self,
        input: &[f32],
        weight: &CpuTensor,
        epilogue: &conv2d::Epilogue,
        shape: &Conv2dShape,
    ) -> Vec<f32> {
        super::depthwise(input, weight.slice(), epilogue, shape)
    }

    fn backward_input(
        &self,
        weight: &CpuTensor,
        grad: &[f32],
        add: Option<&[f32]>,
        shape: &Conv2dShape,
    ) -> Vec<f32> {
        backward_input_with(Isa::best(), grad, weight.slice(), add, shape)
    }

    fn backward_weight(&self, input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
        depthwise_backward_weight(input, grad, shape)
    }
}

/// Depthwise convolution of `input` (`[batch, channels, height, width]`) with `weight`
/// (`[channels, 1, kernel_height, kernel_width]`), with stride 1 and `padding` zeros above and below, left and right.
///
/// Panics when the sizes do not fit each other or the padding is not smaller than the kernel.
pub fn depthwise(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, padding: [usize; 2]) -> Tensor<4> {
    let [channels, inputs, height, width] = weight.dims();
    assert_eq!([channels, inputs], [input.dims()[1], 1], "depthwise: a kernel for each channel");
    let smaller = padding[0] < height && padding[1] < width;
    assert!(smaller, "depthwise: padding of {padding:?} smaller than the kernel of {height}x{width}");
    convolve(Depthwise { padding }, input, weight, epilogue)
}
