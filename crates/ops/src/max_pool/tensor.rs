//! The pooling on tensors: [`max_pool`] with its gradient.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind, unary};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{IntDType, Tensor};

use super::MapSize;
use crate::flex::{Contiguous, sizes, tensor};

/// The pooling; see [`max_pool`].
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait MaxPoolOps: Backend {
    /// Half the input's height and width.
    fn max_pool_halved(input: FloatTensor<Self>) -> FloatTensor<Self> {
        Self::max_pool2d(input, [2; 2], [2; 2], [0; 2], [1; 2], false)
    }
}

/// Gradient of the pooling.
pub trait MaxPoolGradOps: Backend {
    /// Of the input.
    fn max_pool_halved_grad(input: FloatTensor<Self>, grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let (side, padding, dilation) = ([2; 2], [0; 2], [1; 2]);
        let pooled =
            Self::max_pool2d_with_indices(input.clone(), side, side, padding, dilation, false, IntDType::I32);
        let indices = pooled.indices;
        Self::max_pool2d_with_indices_backward(input, side, side, padding, dilation, false, grad, indices)
            .x_grad
    }
}

#[cfg(feature = "cube")]
impl MaxPoolOps for burn_cubecl::CubeBackend {}

#[cfg(feature = "cube")]
impl MaxPoolGradOps for burn_cubecl::CubeBackend {}

fn size_of(input: &impl TensorMetadata) -> (MapSize, [usize; 4]) {
    let [batch, channels, height, width] = sizes(input);
    (MapSize { planes: batch * channels, height, width }, [batch, channels, height / 2, width / 2])
}

impl MaxPoolOps for Flex {
    fn max_pool_halved(input: FloatTensor<Self>) -> FloatTensor<Self> {
        let (size, pooled) = size_of(&input);
        tensor(super::max_pool(Contiguous::new(&input).slice(), size), pooled)
    }
}

impl MaxPoolGradOps for Flex {
    fn max_pool_halved_grad(input: FloatTensor<Self>, grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let (size, _) = size_of(&input);
        let shape = input.shape();
        let [input, grad] = [&input, &grad].map(Contiguous::new);
        tensor(super::max_pool_backward(input.slice(), grad.slice(), size), shape)
    }
}

#[derive(Debug)]
struct MaxPoolBackward;

impl<B: MaxPoolGradOps> Backward<B, 1> for MaxPoolBackward {
    type State = FloatTensor<B>;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        unary::<B, _>(ops.parents, ops.node, grads, |grad| B::max_pool_halved_grad(ops.state, grad));
    }
}

impl<B: MaxPoolOps + MaxPoolGradOps, C: CheckpointStrategy> MaxPoolOps for Autodiff<B, C> {
    fn max_pool_halved(input: FloatTensor<Self>) -> FloatTensor<Self> {
        let guards = [input.node()];
        let input = input.into_primitive();
        let out = B::max_pool_halved(input.clone());
        match MaxPoolBackward.prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(input, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}

/// The largest of each 2x2 pixels of `[batch, channels, height, width]`: `[batch, channels, height / 2, width / 2]`, a last
/// odd row or column left out. The gradient goes to the first of the largest, as in PyTorch.
pub fn max_pool(input: Tensor<4>) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::max_pool_halved(input.into_dispatch()))
}
