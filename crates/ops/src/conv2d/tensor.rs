//! The convolution on tensors: [`conv2d`] with gradients.

use burn::tensor::Tensor;
use srflow_simd::Isa;

use super::backward::{backward_input_packed, pack_backward};
use super::conv2d_backward_weight;
use super::forward::{convolve_packed, pack};
use crate::WeightCache;
pub use crate::convolution::Epilogue;
use crate::convolution::{Conv2dShape, Convolution, convolve};
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
}

impl Convolution for Conv2dOptions {
    fn stride(&self) -> [usize; 2] {
        self.stride
    }

    fn padding(&self) -> [usize; 2] {
        self.padding
    }

    fn forward(
        &self,
        input: &[f32],
        weight: &CpuTensor,
        epilogue: &super::Epilogue,
        shape: &Conv2dShape,
    ) -> Vec<f32> {
        let isa = Isa::best();
        let pack = |weight: &[f32]| pack(isa, weight, shape);
        let packed = self.cache.get(self.packing(Pass::Forward, isa), weight.tensor(), pack);
        convolve_packed(isa, input, &packed, epilogue, shape)
    }

    fn backward_input(
        &self,
        weight: &CpuTensor,
        grad: &[f32],
        add: Option<&[f32]>,
        shape: &Conv2dShape,
    ) -> Vec<f32> {
        let isa = Isa::best();
        let pack = |weight: &[f32]| pack_backward(isa, weight, shape);
        let packed = self.cache.get(self.packing(Pass::Backward, isa), weight.tensor(), pack);
        backward_input_packed(isa, grad, &packed, add, shape)
    }

    fn backward_weight(&self, input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
        conv2d_backward_weight(input, grad, shape)
    }
}

/// Convolution of `input` (`[batch, in_channels, height, width]`) with `weight`
/// (`[out_channels, in_channels, kernel_height, kernel_width]`): `[batch, out_channels, out_height, out_width]`.
///
/// Panics when the sizes do not fit each other.
pub fn conv2d(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, options: Conv2dOptions) -> Tensor<4> {
    assert_eq!(weight.dims()[1], input.dims()[1], "conv2d: channels of the weight and of the input");
    convolve(options, input, weight, epilogue)
}
