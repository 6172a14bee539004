//! The unit's steps on tensors: [`reset`] and [`update`] with gradients.

use burn::tensor::Tensor;
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;

use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

/// Of gates and hidden state.
#[derive(Debug, Clone)]
pub(super) struct Reset;

/// Of gates, hidden state and candidate.
#[derive(Debug, Clone)]
pub(super) struct Update;

impl Operation<2> for Reset {
    fn cpu(&self, [gates, hidden]: [CpuTensor; 2]) -> Vec<CpuTensor> {
        vec![hidden.like(super::reset(gates.slice(), hidden.slice(), &hidden.map_shape()))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        let ([gates, hidden], grad) = back.into_parts();
        let [d_gates, d_hidden] =
            super::reset_backward(gates.slice(), hidden.slice(), grad.slice(), &hidden.map_shape());
        [gates.like(d_gates), hidden.like(d_hidden)].map(Some)
    }

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; 2]) -> Vec<CubeTensor> {
        vec![super::cube::reset(inputs)]
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; 2] {
        let (inputs, grad) = back.into_parts();
        super::cube::reset_backward(inputs, grad).map(Some)
    }
}

impl Operation<3> for Update {
    fn cpu(&self, [gates, hidden, candidate]: [CpuTensor; 3]) -> Vec<CpuTensor> {
        let shape = hidden.map_shape();
        vec![hidden.like(super::update(gates.slice(), hidden.slice(), candidate.slice(), &shape))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 3] {
        let ([gates, hidden, candidate], grad) = back.into_parts();
        let shape = hidden.map_shape();
        let [d_gates, d_hidden, d_candidate] =
            super::update_backward(gates.slice(), hidden.slice(), candidate.slice(), grad.slice(), &shape);
        [gates.like(d_gates), hidden.like(d_hidden), candidate.like(d_candidate)].map(Some)
    }

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; 3]) -> Vec<CubeTensor> {
        vec![super::cube::update(inputs)]
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; 3] {
        let (inputs, grad) = back.into_parts();
        super::cube::update_backward(inputs, grad).map(Some)
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
    apply(Reset, [gates.into_dispatch(), hidden.into_dispatch()])
}

/// The next hidden state: from `hidden` towards `candidate` as far as the update gates, the first half of `gates`, say.
/// Panics when the sizes do not fit.
pub fn update(gates: Tensor<4>, hidden: Tensor<4>, candidate: Tensor<4>) -> Tensor<4> {
    check(&gates, &hidden);
    assert_eq!(candidate.dims(), hidden.dims(), "a candidate for each hidden element");
    apply(Update, [gates.into_dispatch(), hidden.into_dispatch(), candidate.into_dispatch()])
}
