//! The convolution on tensors: [`conv2d`] with gradients.

use std::sync::Arc;

use burn::tensor::Tensor;
use srflow_simd::{Isa, Packed};

use super::{pack, pack_backward};
use crate::WeightCache;
pub use crate::convolution::Epilogue;
use crate::convolution::{Conv2dShape, Kernels, convolve};
use crate::flex::CpuTensor;
use crate::precision::cpu_precision;
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

    /// The weight in the order of the dense kernels.
    pub(crate) fn packed(&self, pass: Pass, weight: &CpuTensor, shape: &Conv2dShape) -> Arc<Packed> {
        let (isa, precision) = (Isa::best(), cpu_precision());
        let packing = Packing { pass, isa, precision, stride: shape.stride, padding: shape.padding };
        self.cache.get(packing, weight.tensor(), |weight| match pass {
            Pass::Forward => pack(isa, precision, weight, shape),
            Pass::Backward => pack_backward(isa, precision, weight, shape),
        })
    }
}

/// Convolution of `input` (`[batch, in_channels, height, width]`) with `weight`
/// (`[out_channels, in_channels, kernel_height, kernel_width]`): `[batch, out_channels, out_height, out_width]`.
///
/// Panics when the sizes do not fit each other.
pub fn conv2d(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, options: Conv2dOptions) -> Tensor<4> {
    assert_eq!(weight.dims()[1], input.dims()[1], "conv2d: channels of the weight and of the input");
    convolve(Kernels::Dense, input, weight, epilogue, options)
}
