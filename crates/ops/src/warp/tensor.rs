//! The warp on tensors: [`warp`] with gradients.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Shape, Tensor};

use super::WarpShape;
use crate::flex::{Contiguous, tensor};
use crate::gradients;

/// The warp; see [`warp`].
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait WarpOps: Backend {
    /// Of the image's shape.
    fn warped(image: FloatTensor<Self>, flow: FloatTensor<Self>) -> FloatTensor<Self>;
}

/// Gradients of the warp.
pub trait WarpGradOps: Backend {
    /// Gradients of the image and of the flow.
    fn warped_grad(
        image: FloatTensor<Self>,
        flow: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

fn shape_of(image: &Shape) -> WarpShape {
    let [batch, channels, height, width] = image.dims();
    WarpShape { batch, channels, size: [height, width] }
}

impl WarpOps for Flex {
    fn warped(image: FloatTensor<Self>, flow: FloatTensor<Self>) -> FloatTensor<Self> {
        let shape = image.shape();
        let (image, flow) = (Contiguous::new(&image), Contiguous::new(&flow));
        tensor(super::warp(image.slice(), flow.slice(), &shape_of(&shape)), shape)
    }
}

impl WarpGradOps for Flex {
    fn warped_grad(
        image: FloatTensor<Self>,
        flow: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let shapes = (image.shape(), flow.shape());
        let (image, flow, grad) = (Contiguous::new(&image), Contiguous::new(&flow), Contiguous::new(&grad));
        let (d_image, d_flow) =
            super::warp_backward(image.slice(), flow.slice(), grad.slice(), &shape_of(&shapes.0));
        (tensor(d_image, shapes.0), tensor(d_flow, shapes.1))
    }
}

#[derive(Debug)]
struct WarpBackward;

impl<B: WarpGradOps> Backward<B, 2> for WarpBackward {
    type State = (FloatTensor<B>, FloatTensor<B>);

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        gradients::register::<B, _, 2>(ops, grads, |(image, flow), grad| {
            B::warped_grad(image, flow, grad).into()
        });
    }
}

impl<B: WarpOps + WarpGradOps, C: CheckpointStrategy> WarpOps for Autodiff<B, C> {
    fn warped(image: FloatTensor<Self>, flow: FloatTensor<Self>) -> FloatTensor<Self> {
        let guards = [image.node(), flow.node()];
        let (image, flow) = (image.into_primitive(), flow.into_primitive());
        let out = B::warped(image.clone(), flow.clone());
        match WarpBackward.prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((image, flow), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}

/// `image` (`[batch, channels, height, width]`) sampled at each pixel displaced by `flow` (`[batch, 2, height, width]`, in
/// pixels, u then v). Panics when the sizes do not fit.
pub fn warp(image: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let [batch, _, height, width] = image.dims();
    assert_eq!(flow.dims(), [batch, 2, height, width], "warp: a displacement for each pixel");
    Tensor::from_dispatch(Dispatch::warped(image.into_dispatch(), flow.into_dispatch()))
}
