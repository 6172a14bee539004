//! The activation of a sum on tensors, with gradients.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;
use burn::tensor::Tensor;

use super::{Activation, activate_tensor, activate_tensor_backward, activated, activation_backward};
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

    fn cpu_backward(&self, back: Backprop<CpuTensor, 2>) -> [Option<CpuTensor>; 2] {
        let ([], grad) = back.into_parts();
        [Some(grad.clone()), Some(grad)]
    }

    fn composed<B: Backend>(&self, [a, b]: [FloatTensor<B>; 2]) -> Vec<FloatTensor<B>> {
        vec![activate_tensor::<B>(B::float_add(a, b), self.0)]
    }

    fn composed_backward<B: Backend>(
        &self,
        back: Backprop<FloatTensor<B>, 2>,
    ) -> [Option<FloatTensor<B>>; 2] {
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

    fn cpu_backward(&self, back: Backprop<CpuTensor, 1>) -> [Option<CpuTensor>; 1] {
        let ([kept], grad) = back.into_parts();
        [Some(grad.change(|grad| activation_backward(self.0, kept.slice(), grad)))]
    }

    fn composed<B: Backend>(&self, [x]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        vec![activate_tensor::<B>(x, self.0)]
    }

    fn composed_backward<B: Backend>(
        &self,
        back: Backprop<FloatTensor<B>, 1>,
    ) -> [Option<FloatTensor<B>>; 1] {
        let ([kept], grad) = back.into_parts();
        [Some(activate_tensor_backward::<B>(grad, kept, self.0))]
    }
}

/// `activation(a + b)`. Panics when the sizes differ.
pub fn activated_sum(a: Tensor<4>, b: Tensor<4>, activation: Activation) -> Tensor<4> {
    assert_eq!(a.dims(), b.dims(), "summands of one size");
    apply(ActivatedSum(activation), [a.into_dispatch(), b.into_dispatch()])
}
