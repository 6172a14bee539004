//! The convolution on tensors: [`conv2d`] with gradients.

use burn::tensor::ops::ConvOptions;
use burn::tensor::{Shape, Tensor};
use srflow_simd::Isa;

use super::backward::{backward_input_packed, pack_backward};
use super::forward::{convolve_packed, pack};
use super::{Conv2dShape, conv2d_backward_weight};
use crate::WeightCache;
pub use crate::convolution::Epilogue;
use crate::convolution::{Convolution, convolve};
use crate::flex::CpuTensor;
use crate::weight_cache::{Packing, Pass};

/// How a kernel moves over its input.
#[derive(Debug, Clone)]
pub struct Conv2dOptions {
    /// Stride down and across.
    pub stride: [usize; 2],
    /// Zeros added above and below, left and right.
    pub padding: [usize; 2],
    /// Of the weight.
    pub cache: WeightCache,
}

impl Conv2dOptions {
    /// With a cache that no other call shares.
    pub fn new(stride: [usize; 2], padding: [usize; 2]) -> Self {
        Self { stride, padding, cache: WeightCache::default() }
    }

    fn packing(&self, pass: Pass, isa: Isa) -> Packing {
        Packing { pass, isa, stride: self.stride, padding: self.padding }
    }

    fn shape(&self, input: Shape, weight: Shape) -> Conv2dShape {
        let [batch, in_channels, height, width] = input.dims();
        let [out_channels, _, kernel_height, kernel_width] = weight.dims();
        Conv2dShape {
            batch,
            in_channels,
            out_channels,
            input: [height, width],
            kernel: [kernel_height, kernel_width],
            stride: self.stride,
            padding: self.padding,
        }
    }
}

impl Convolution for Conv2dOptions {
    fn options(&self, _channels: usize) -> ConvOptions<2> {
        ConvOptions::new(self.stride, self.padding, [1, 1], 1)
    }

    fn cpu(&self, input: &CpuTensor, weight: &CpuTensor, epilogue: &super::Epilogue) -> CpuTensor {
        let shape = self.shape(input.shape(), weight.shape());
        let isa = Isa::best();
        let pack = |weight: &[f32]| pack(isa, weight, &shape);
        let packed = self.cache.get(self.packing(Pass::Forward, isa), weight.tensor(), pack);
        let out = convolve_packed(isa, input.slice(), &packed, epilogue, &shape);
        let [height, width] = shape.output();
        CpuTensor::new(out, [shape.batch, shape.out_channels, height, width])
    }

    fn cpu_backward_input(
        &self,
        [input, weight]: &[CpuTensor; 2],
        grad: &CpuTensor,
        add: Option<&CpuTensor>,
    ) -> CpuTensor {
        let shape = self.shape(input.shape(), weight.shape());
        let isa = Isa::best();
        let pack = |weight: &[f32]| pack_backward(isa, weight, &shape);
        let packed = self.cache.get(self.packing(Pass::Backward, isa), weight.tensor(), pack);
        let add = add.map(CpuTensor::slice);
        input.like(backward_input_packed(isa, grad.slice(), &packed, add, &shape))
    }

    fn cpu_backward_weight(&self, [input, weight]: &[CpuTensor; 2], grad: &CpuTensor) -> CpuTensor {
        let shape = self.shape(input.shape(), weight.shape());
        weight.like(conv2d_backward_weight(input.slice(), grad.slice(), &shape))
    }
}

/// Convolution of `input` (`[batch, in_channels, height, width]`) with `weight`
/// (`[out_channels, in_channels, kernel_height, kernel_width]`): `[batch, out_channels, out_height, out_width]`.
///
/// Panics when the sizes do not fit each other.
pub fn conv2d(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, options: Conv2dOptions) -> Tensor<4> {
    let shape = options.shape(input.shape(), weight.shape());
    assert_eq!(weight.dims()[1], shape.in_channels, "conv2d: channels of the weight and of the input");
    let [height, width] = shape.output();
    assert!(height > 0 && width > 0, "conv2d: the kernel does not fit the input: {shape:?}");
    convolve(options, input, weight, epilogue, [shape.batch, shape.out_channels, height, width])
}
