//! The normalization on tensors: [`instance_norm`] with its gradient.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind, unary};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Shape, Tensor};

use super::composed::{gradient, normalized};
use crate::Activation;
use crate::flex::{Contiguous, tensor};
use crate::tracked::{EpilogueGradOps, kept_and_output};

/// The normalization; see [`instance_norm`].
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait InstanceNormOps: Backend {
    /// Of the input's shape.
    fn instance_normalization(input: FloatTensor<Self>, activation: Activation) -> FloatTensor<Self> {
        normalized::<Self>(input, activation)
    }
}

/// Gradient of the normalization without activation.
pub trait InstanceNormGradOps: Backend {
    /// Gradient of the input.
    fn instance_normalization_grad(input: FloatTensor<Self>, grad: FloatTensor<Self>) -> FloatTensor<Self> {
        gradient::<Self>(input, grad)
    }
}

#[cfg(feature = "cube")]
impl InstanceNormOps for burn_cubecl::CubeBackend {}

#[cfg(feature = "cube")]
impl InstanceNormGradOps for burn_cubecl::CubeBackend {}

fn pixels(shape: &Shape) -> usize {
    let [_, _, height, width] = shape.dims();
    height * width
}

impl InstanceNormOps for Flex {
    fn instance_normalization(input: FloatTensor<Self>, activation: Activation) -> FloatTensor<Self> {
        let shape = input.shape();
        let input = Contiguous::new(&input);
        tensor(super::instance_norm(input.slice(), pixels(&shape), activation), shape)
    }
}

impl InstanceNormGradOps for Flex {
    fn instance_normalization_grad(input: FloatTensor<Self>, grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let shape = input.shape();
        let (input, grad) = (Contiguous::new(&input), Contiguous::new(&grad));
        tensor(super::instance_norm_backward(input.slice(), grad.slice(), pixels(&shape)), shape)
    }
}

#[derive(Debug)]
struct InstanceNormBackward(Activation);

impl<B: InstanceNormGradOps + EpilogueGradOps> Backward<B, 1> for InstanceNormBackward {
    /// The input and what the derivative of the activation needs.
    type State = (FloatTensor<B>, Option<FloatTensor<B>>);

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let (input, kept) = ops.state;
        unary::<B, _>(ops.parents, ops.node, grads, |grad| {
            let grad = match kept {
                Some(kept) => B::sums_grad(grad, kept, self.0),
                None => grad,
            };
            B::instance_normalization_grad(input, grad)
        });
    }
}

impl<B, C> InstanceNormOps for Autodiff<B, C>
where
    B: InstanceNormOps + InstanceNormGradOps + EpilogueGradOps,
    C: CheckpointStrategy,
{
    fn instance_normalization(input: FloatTensor<Self>, activation: Activation) -> FloatTensor<Self> {
        let guards = [input.node()];
        let input = input.into_primitive();
        match InstanceNormBackward(activation).prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::UnTracked(prep) => prep.finish(B::instance_normalization(input, activation)),
            OpsKind::Tracked(prep) => {
                let run = |applied| B::instance_normalization(input.clone(), applied);
                let (kept, out) = kept_and_output::<B>(activation, run);
                prep.finish((input, kept), out)
            }
        }
    }
}

/// Each channel of each image (`[batch, channels, height, width]`) less its mean, over its standard deviation, then the
/// activation. Panics when there are no pixels.
pub fn instance_norm(input: Tensor<4>, activation: Activation) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::instance_normalization(input.into_dispatch(), activation))
}
