//! The steps and their gradients by a backend's own operations, for devices that have no kernel of them.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::Slice;

/// See [`super::reset`].
pub(super) fn reset<B: Backend>([gates, hidden]: [FloatTensor<B>; 2]) -> FloatTensor<B> {
    let [_, reset] = halves::<B>(gates);
    B::float_mul(reset, hidden)
}

/// See [`super::reset_backward`].
pub(super) fn reset_backward<B: Backend>(
    [gates, hidden]: [FloatTensor<B>; 2],
    grad: FloatTensor<B>,
) -> [FloatTensor<B>; 2] {
    let [_, reset] = halves::<B>(gates);
    let d_reset = B::float_mul(grad.clone(), hidden);
    let d_gates = B::float_cat(vec![zeros_like::<B>(&d_reset), d_reset], 1);
    [d_gates, B::float_mul(grad, reset)]
}

/// See [`super::update`].
pub(super) fn update<B: Backend>([gates, hidden, candidate]: [FloatTensor<B>; 3]) -> FloatTensor<B> {
    let [update, _] = halves::<B>(gates);
    let way = B::float_sub(candidate, hidden.clone());
    B::float_add(hidden, B::float_mul(update, way))
}

/// See [`super::update_backward`].
pub(super) fn update_backward<B: Backend>(
    [gates, hidden, candidate]: [FloatTensor<B>; 3],
    grad: FloatTensor<B>,
) -> [FloatTensor<B>; 3] {
    let [update, _] = halves::<B>(gates);
    let d_update = B::float_mul(grad.clone(), B::float_sub(candidate, hidden));
    let zeros = zeros_like::<B>(&d_update);
    let d_candidate = B::float_mul(grad.clone(), update);
    let d_hidden = B::float_sub(grad, d_candidate.clone());
    [B::float_cat(vec![d_update, zeros], 1), d_hidden, d_candidate]
}

/// Update gates and reset gates.
fn halves<B: Backend>(gates: FloatTensor<B>) -> [FloatTensor<B>; 2] {
    let both = gates.shape()[1];
    let part = |first: usize| {
        let channels = Slice::from(first..first + both / 2);
        B::float_slice(gates.clone(), &[Slice::full(), channels, Slice::full(), Slice::full()])
    };
    [part(0), part(both / 2)]
}

fn zeros_like<B: Backend>(x: &FloatTensor<B>) -> FloatTensor<B> {
    B::float_zeros(x.shape(), &x.device(), x.dtype().into())
}
