//! The upsampling on tensors: [`convex_upsample`] with gradients.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Shape, Tensor};

use super::UpsampleShape;
use super::composed::{gradients, upsampled};
use crate::flex::{Contiguous, tensor};
use crate::gradients;

/// The upsampling; see [`convex_upsample`].
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait UpsampleOps: Backend {
    /// Fine flow.
    fn convex_upsampling(
        flow: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        scale: f32,
        factor: usize,
    ) -> FloatTensor<Self> {
        let shape = shape_of(&flow.shape(), factor);
        upsampled::<Self>(flow, mask, scale, &shape)
    }
}

/// Gradients of the upsampling.
pub trait UpsampleGradOps: Backend {
    /// Gradients of the flow and of the mask.
    fn convex_upsampling_grad(
        flow: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        scale: f32,
        factor: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let shape = shape_of(&flow.shape(), factor);
        gradients::<Self>(flow, mask, scale, grad, &shape)
    }
}

#[cfg(feature = "cube")]
impl UpsampleOps for burn_cubecl::CubeBackend {}

#[cfg(feature = "cube")]
impl UpsampleGradOps for burn_cubecl::CubeBackend {}

fn shape_of(flow: &Shape, factor: usize) -> UpsampleShape {
    let [batch, _, height, width] = flow.dims();
    UpsampleShape { batch, coarse: [height, width], factor }
}

impl UpsampleOps for Flex {
    fn convex_upsampling(
        flow: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        scale: f32,
        factor: usize,
    ) -> FloatTensor<Self> {
        let shape = shape_of(&flow.shape(), factor);
        let (flow, mask) = (Contiguous::new(&flow), Contiguous::new(&mask));
        let out = super::convex_upsample(flow.slice(), mask.slice(), scale, &shape);
        tensor(out, [shape.batch, 2, shape.coarse[0] * factor, shape.coarse[1] * factor])
    }
}

impl UpsampleGradOps for Flex {
    fn convex_upsampling_grad(
        flow: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        scale: f32,
        factor: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let shape = shape_of(&flow.shape(), factor);
        let shapes = (flow.shape(), mask.shape());
        let (flow, mask, grad) = (Contiguous::new(&flow), Contiguous::new(&mask), Contiguous::new(&grad));
        let (d_flow, d_mask) =
            super::convex_upsample_backward(flow.slice(), mask.slice(), scale, grad.slice(), &shape);
        (tensor(d_flow, shapes.0), tensor(d_mask, shapes.1))
    }
}

#[derive(Debug)]
struct UpsampleBackward;

impl<B: UpsampleGradOps> Backward<B, 2> for UpsampleBackward {
    type State = (FloatTensor<B>, FloatTensor<B>, f32, usize);

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        gradients::register::<B, _, 2>(ops, grads, |(flow, mask, scale, factor), grad| {
            B::convex_upsampling_grad(flow, mask, grad, scale, factor).into()
        });
    }
}

impl<B: UpsampleOps + UpsampleGradOps, C: CheckpointStrategy> UpsampleOps for Autodiff<B, C> {
    fn convex_upsampling(
        flow: FloatTensor<Self>,
        mask: FloatTensor<Self>,
        scale: f32,
        factor: usize,
    ) -> FloatTensor<Self> {
        let guards = [flow.node(), mask.node()];
        let (flow, mask) = (flow.into_primitive(), mask.into_primitive());
        let out = B::convex_upsampling(flow.clone(), mask.clone(), scale, factor);
        match UpsampleBackward.prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((flow, mask, scale, factor), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
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
        [batch, super::NEIGHBOURS * factor * factor, height, width],
        "convex_upsample: nine weights for each fine pixel"
    );
    let (flow, mask) = (flow.into_dispatch(), mask.into_dispatch());
    Tensor::from_dispatch(Dispatch::convex_upsampling(flow, mask, scale, factor))
}
