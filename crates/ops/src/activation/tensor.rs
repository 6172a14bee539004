//! The activation of a sum on tensors, with gradients.

use burn::tensor::Tensor;

use super::{Activation, activated, activation_backward};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct ActivatedSum(pub(super) Activation);

impl Operation<2> for ActivatedSum {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.0)
    }

    fn saved_inputs<T>(_: &[T; 2]) -> &[T] {
        &[]
    }

    fn cpu(&self, [a, b]: [CpuTensor; 2]) -> Vec<CpuTensor> {
        vec![a.like(activated(self.0, a.slice(), Some(b.slice())))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        let ([], grad) = back.into_parts();
        [Some(grad.clone()), Some(grad)]
    }
}

/// The activation alone. Its backward is given what [`Activation::keeps`] says in place of the saved.
#[derive(Debug, Clone)]
pub(crate) struct Activate(pub(crate) Activation);

impl Operation<1> for Activate {
    fn cpu(&self, [x]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        vec![x.like(activated(self.0, x.slice(), None))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([kept], grad) = back.into_parts();
        [Some(grad.change(|grad| activation_backward(self.0, kept.slice(), grad)))]
    }
}

/// `activation(a + b)`. Panics when the sizes differ.
pub fn activated_sum(a: Tensor<4>, b: Tensor<4>, activation: Activation) -> Tensor<4> {
    assert_eq!(a.dims(), b.dims(), "summands of one size");
    apply(ActivatedSum(activation), [a.into_dispatch(), b.into_dispatch()])
}
