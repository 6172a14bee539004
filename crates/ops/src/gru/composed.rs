//! The steps composed of a backend's own operations.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::Slice;

use super::tensor::{Reset, Update};
use crate::operation::{Backprop, Composition};

impl Composition<2> for Reset {
    fn composed<B: Backend>(&self, [gates, hidden]: [FloatTensor<B>; 2]) -> Vec<FloatTensor<B>> {
        let [_, reset] = halves::<B>(gates);
        vec![B::float_mul(reset, hidden)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 2] {
        let ([gates, hidden], grad) = back.into_parts();
        let [_, reset] = halves::<B>(gates);
        let d_reset = B::float_mul(grad.clone(), hidden);
        let d_gates = B::float_cat(vec![zeros_like::<B>(&d_reset), d_reset], 1);
        [d_gates, B::float_mul(grad, reset)].map(Some)
    }
}

impl Composition<3> for Update {
    fn composed<B: Backend>(&self, inputs: [FloatTensor<B>; 3]) -> Vec<FloatTensor<B>> {
        let [gates, hidden, candidate] = inputs;
        let [update, _] = halves::<B>(gates);
        let way = B::float_sub(candidate, hidden.clone());
        vec![B::float_add(hidden, B::float_mul(update, way))]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 3] {
        let ([gates, hidden, candidate], grad) = back.into_parts();
        let [update, _] = halves::<B>(gates);
        let d_update = B::float_mul(grad.clone(), B::float_sub(candidate, hidden));
        let zeros = zeros_like::<B>(&d_update);
        let d_candidate = B::float_mul(grad.clone(), update);
        let d_hidden = B::float_sub(grad, d_candidate.clone());
        [B::float_cat(vec![d_update, zeros], 1), d_hidden, d_candidate].map(Some)
    }
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
