//! The depthwise convolution on tensors: [`depthwise`] with gradients.

use burn::tensor::ops::ConvOptions;
use burn::tensor::{Shape, Tensor};
use srflow_simd::Isa;

use super::backward::backward_input_with;
use super::{DepthwiseShape, depthwise_backward_weight};
use crate::conv2d;
use crate::convolution::{Convolution, Epilogue, convolve};
use crate::flex::CpuTensor;

#[derive(Debug, Clone)]
pub(super) struct Depthwise {
    pub(super) padding: [usize; 2],
}

impl Depthwise {
    fn shape(&self, input: Shape, weight: Shape) -> DepthwiseShape {
        let [batch, channels, height, width] = input.dims();
        let [_, _, kernel_height, kernel_width] = weight.dims();
        let (input, kernel) = ([height, width], [kernel_height, kernel_width]);
        DepthwiseShape { batch, channels, input, kernel, padding: self.padding }
    }
}

impl Convolution for Depthwise {
    fn options(&self, channels: usize) -> ConvOptions<2> {
        ConvOptions::new([1, 1], self.padding, [1, 1], channels)
    }

    fn cpu(&self, input: &CpuTensor, weight: &CpuTensor, epilogue: &conv2d::Epilogue) -> CpuTensor {
        let shape = self.shape(input.shape(), weight.shape());
        let out = super::depthwise(input.slice(), weight.slice(), epilogue, &shape);
        let [height, width] = shape.output();
        CpuTensor::new(out, [shape.batch, shape.channels, height, width])
    }

    fn cpu_backward_input(
        &self,
        [input, weight]: &[CpuTensor; 2],
        grad: &CpuTensor,
        add: Option<&CpuTensor>,
    ) -> CpuTensor {
        let shape = self.shape(input.shape(), weight.shape());
        let add = add.map(CpuTensor::slice);
        input.like(backward_input_with(Isa::best(), grad.slice(), weight.slice(), add, &shape))
    }

    fn cpu_backward_weight(&self, [input, weight]: &[CpuTensor; 2], grad: &CpuTensor) -> CpuTensor {
        let shape = self.shape(input.shape(), weight.shape());
        weight.like(depthwise_backward_weight(input.slice(), grad.slice(), &shape))
    }
}

/// Depthwise convolution of `input` (`[batch, channels, height, width]`) with `weight`
/// (`[channels, 1, kernel_height, kernel_width]`), with stride 1 and `padding` zeros above and below, left and right.
///
/// Panics when the sizes do not fit each other or the padding is not smaller than the kernel.
pub fn depthwise(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, padding: [usize; 2]) -> Tensor<4> {
    let convolution = Depthwise { padding };
    let shape = convolution.shape(input.shape(), weight.shape());
    assert_eq!(weight.dims()[..2], [shape.channels, 1], "depthwise: a kernel for each channel");
    let smaller = shape.padding.iter().zip(shape.kernel).all(|(&padding, kernel)| padding < kernel);
    assert!(smaller, "depthwise: padding smaller than the kernel: {shape:?}");
    let [height, width] = shape.output();
    assert!(height > 0 && width > 0, "depthwise: the kernel does not fit the input: {shape:?}");
    convolve(convolution, input, weight, epilogue, [shape.batch, shape.channels, height, width])
}
