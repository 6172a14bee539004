//! The upsampling on tensors: [`convex_upsample`] with gradients.

#[cfg(feature = "cube")]
use burn::backend::TensorMetadata;
use burn::tensor::{Shape, Tensor};
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;

use super::{NEIGHBOURS, UpsampleShape};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

/// Of flow and mask.
#[derive(Debug, Clone)]
pub(super) struct ConvexUpsample {
    pub(super) scale: f32,
    pub(super) factor: usize,
}

impl ConvexUpsample {
    pub(super) fn shape(&self, flow: Shape) -> UpsampleShape {
        let [batch, _, height, width] = flow.dims();
        UpsampleShape { batch, coarse: [height, width], factor: self.factor }
    }
}

impl Operation<2> for ConvexUpsample {
    fn cpu(&self, [flow, mask]: [CpuTensor; 2]) -> Vec<CpuTensor> {
        let shape = self.shape(flow.shape());
        let fine = super::convex_upsample(flow.slice(), mask.slice(), self.scale, &shape);
        let [height, width] = shape.coarse.map(|size| size * self.factor);
        vec![CpuTensor::new(fine, [shape.batch, 2, height, width])]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        let ([flow, mask], grad) = back.into_parts();
        let shape = self.shape(flow.shape());
        let [d_flow, d_mask] =
            super::convex_upsample_backward(flow.slice(), mask.slice(), self.scale, grad.slice(), &shape);
        [flow.like(d_flow), mask.like(d_mask)].map(Some)
    }

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; 2]) -> Vec<CubeTensor> {
        let shape = self.shape(inputs[0].shape());
        vec![super::cube::convex_upsample(inputs, self.scale, &shape)]
    }
}

/// Flow in pixels of a grid `factor` times finer, `[batch, 2, factor * height, factor * width]`, from `flow`
/// (`[batch, 2, height, width]`) with the weights `softmax(scale * mask)`, `mask` of
/// `[batch, 9 factor^2, height, width]`. Panics when the sizes do not fit.
pub fn convex_upsample(flow: Tensor<4>, mask: Tensor<4>, scale: f32, factor: usize) -> Tensor<4> {
    let [batch, channels, height, width] = flow.dims();
    assert_eq!(channels, 2, "convex_upsample: a flow has two channels");
    assert_eq!(
        mask.dims(),
        [batch, NEIGHBOURS * factor * factor, height, width],
        "convex_upsample: nine weights for each fine pixel"
    );
    apply(ConvexUpsample { scale, factor }, [flow.into_dispatch(), mask.into_dispatch()])
}
