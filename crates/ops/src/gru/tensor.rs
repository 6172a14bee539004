//! The unit's steps on tensors: [`reset`] and [`update`] with gradients.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Slice, Tensor};

use super::GruSize;
use crate::flex::{Contiguous, sizes, tensor};
use crate::gradients;

/// The steps. The defaults are made of Burn's operations.
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait GruOps: Backend {
    /// See [`reset`].
    fn gru_reset(gates: FloatTensor<Self>, hidden: FloatTensor<Self>) -> FloatTensor<Self> {
        let [_, reset] = halves::<Self>(gates);
        Self::float_mul(reset, hidden)
    }

    /// See [`update`].
    fn gru_update(
        gates: FloatTensor<Self>,
        hidden: FloatTensor<Self>,
        candidate: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let [update, _] = halves::<Self>(gates);
        let way = Self::float_sub(candidate, hidden.clone());
        Self::float_add(hidden, Self::float_mul(update, way))
    }
}

/// Gradients of the steps. The defaults are made of Burn's operations.
pub trait GruGradOps: Backend {
    /// Of gates and hidden state.
    fn gru_reset_grad(
        gates: FloatTensor<Self>,
        hidden: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> [FloatTensor<Self>; 2] {
        let [_, reset] = halves::<Self>(gates);
        let d_reset = Self::float_mul(grad.clone(), hidden);
        let d_update = Self::float_zeros(d_reset.shape(), &d_reset.device(), d_reset.dtype().into());
        [Self::float_cat(vec![d_update, d_reset], 1), Self::float_mul(grad, reset)]
    }

    /// Of gates, hidden state and candidate.
    fn gru_update_grad(
        gates: FloatTensor<Self>,
        hidden: FloatTensor<Self>,
        candidate: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> [FloatTensor<Self>; 3] {
        let [update, _] = halves::<Self>(gates);
        let d_update = Self::float_mul(grad.clone(), Self::float_sub(candidate, hidden));
        let d_reset = Self::float_zeros(d_update.shape(), &d_update.device(), d_update.dtype().into());
        let d_candidate = Self::float_mul(grad.clone(), update);
        let d_hidden = Self::float_sub(grad, d_candidate.clone());
        [Self::float_cat(vec![d_update, d_reset], 1), d_hidden, d_candidate]
    }
}

/// Update gates and reset gates.
fn halves<B: Backend>(gates: FloatTensor<B>) -> [FloatTensor<B>; 2] {
    let [_, both, _, _] = sizes(&gates);
    let part = |first: usize| {
        let channels = Slice::from(first..first + both / 2);
        B::float_slice(gates.clone(), &[Slice::full(), channels, Slice::full(), Slice::full()])
    };
    [part(0), part(both / 2)]
}

#[cfg(feature = "cube")]
impl GruOps for burn_cubecl::CubeBackend {}

#[cfg(feature = "cube")]
impl GruGradOps for burn_cubecl::CubeBackend {}

fn size_of(hidden: &impl TensorMetadata) -> GruSize {
    let [batch, channels, height, width] = sizes(hidden);
    GruSize { batch, channels, pixels: height * width }
}

impl GruOps for Flex {
    fn gru_reset(gates: FloatTensor<Self>, hidden: FloatTensor<Self>) -> FloatTensor<Self> {
        let (shape, size) = (hidden.shape(), size_of(&hidden));
        let [gates, hidden] = [&gates, &hidden].map(Contiguous::new);
        tensor(super::reset(gates.slice(), hidden.slice(), size), shape)
    }

    fn gru_update(
        gates: FloatTensor<Self>,
        hidden: FloatTensor<Self>,
        candidate: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let (shape, size) = (hidden.shape(), size_of(&hidden));
        let [gates, hidden, candidate] = [&gates, &hidden, &candidate].map(Contiguous::new);
        tensor(super::update(gates.slice(), hidden.slice(), candidate.slice(), size), shape)
    }
}

impl GruGradOps for Flex {
    fn gru_reset_grad(
        gates: FloatTensor<Self>,
        hidden: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> [FloatTensor<Self>; 2] {
        let (shapes, size) = ([gates.shape(), hidden.shape()], size_of(&hidden));
        let [gates, hidden, grad] = [&gates, &hidden, &grad].map(Contiguous::new);
        let [d_gates, d_hidden] = super::reset_backward(gates.slice(), hidden.slice(), grad.slice(), size);
        let [of_gates, of_hidden] = shapes;
        [tensor(d_gates, of_gates), tensor(d_hidden, of_hidden)]
    }

    fn gru_update_grad(
        gates: FloatTensor<Self>,
        hidden: FloatTensor<Self>,
        candidate: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> [FloatTensor<Self>; 3] {
        let (of_gates, of_hidden, size) = (gates.shape(), hidden.shape(), size_of(&hidden));
        let [gates, hidden, candidate, grad] = [&gates, &hidden, &candidate, &grad].map(Contiguous::new);
        let [d_gates, d_hidden, d_candidate] =
            super::update_backward(gates.slice(), hidden.slice(), candidate.slice(), grad.slice(), size);
        [tensor(d_gates, of_gates), tensor(d_hidden, of_hidden.clone()), tensor(d_candidate, of_hidden)]
    }
}

#[derive(Debug)]
struct ResetBackward;

impl<B: GruGradOps> Backward<B, 2> for ResetBackward {
    type State = [FloatTensor<B>; 2];

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        gradients::register::<B, _, 2>(ops, grads, |[gates, hidden], grad| {
            B::gru_reset_grad(gates, hidden, grad)
        });
    }
}

#[derive(Debug)]
struct UpdateBackward;

impl<B: GruGradOps> Backward<B, 3> for UpdateBackward {
    type State = [FloatTensor<B>; 3];

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        gradients::register::<B, _, 3>(ops, grads, |[gates, hidden, candidate], grad| {
            B::gru_update_grad(gates, hidden, candidate, grad)
        });
    }
}

impl<B: GruOps + GruGradOps, C: CheckpointStrategy> GruOps for Autodiff<B, C> {
    fn gru_reset(gates: FloatTensor<Self>, hidden: FloatTensor<Self>) -> FloatTensor<Self> {
        let nodes = [gates.node(), hidden.node()];
        let inputs = [gates, hidden].map(|tensor| tensor.into_primitive());
        let [gates, hidden] = inputs.clone();
        let out = B::gru_reset(gates, hidden);
        match ResetBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(inputs, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn gru_update(
        gates: FloatTensor<Self>,
        hidden: FloatTensor<Self>,
        candidate: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let nodes = [gates.node(), hidden.node(), candidate.node()];
        let inputs = [gates, hidden, candidate].map(|tensor| tensor.into_primitive());
        let [gates, hidden, candidate] = inputs.clone();
        let out = B::gru_update(gates, hidden, candidate);
        match UpdateBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(inputs, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}

fn check(gates: &Tensor<4>, hidden: &Tensor<4>) {
    let [batch, channels, height, width] = hidden.dims();
    assert_eq!(gates.dims(), [batch, 2 * channels, height, width], "two gates for each hidden element");
}

/// The hidden state (`[batch, channels, height, width]`) times the reset gates, the second half of `gates`
/// (`[batch, 2 channels, height, width]`). Panics when the sizes do not fit.
pub fn reset(gates: Tensor<4>, hidden: Tensor<4>) -> Tensor<4> {
    check(&gates, &hidden);
    Tensor::from_dispatch(Dispatch::gru_reset(gates.into_dispatch(), hidden.into_dispatch()))
}

/// The next hidden state: from `hidden` towards `candidate` as far as the update gates, the first half of `gates`, say.
/// Panics when the sizes do not fit.
pub fn update(gates: Tensor<4>, hidden: Tensor<4>, candidate: Tensor<4>) -> Tensor<4> {
    check(&gates, &hidden);
    assert_eq!(candidate.dims(), hidden.dims(), "a candidate for each hidden element");
    Tensor::from_dispatch(Dispatch::gru_update(
        gates.into_dispatch(),
        hidden.into_dispatch(),
        candidate.into_dispatch(),
    ))
}
