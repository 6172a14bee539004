//! The normalization on tensors: [`instance_norm`] with its gradient.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;
use burn::tensor::Tensor;

use super::composed;
use crate::Activation;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct InstanceNorm(pub(super) Activation);

fn pixels(input: &CpuTensor) -> usize {
    let [_, _, height, width] = input.dims();
    height * width
}

impl Operation<1> for InstanceNorm {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.0)
    }

    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        vec![input.like(super::instance_norm(input.slice(), pixels(&input), self.0))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor, 1>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        [Some(input.like(super::instance_norm_backward(input.slice(), grad.slice(), pixels(&input))))]
    }

    fn composed<B: Backend>(&self, [input]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        vec![composed::normalized::<B>(input, self.0)]
    }

    fn composed_backward<B: Backend>(
        &self,
        back: Backprop<FloatTensor<B>, 1>,
    ) -> [Option<FloatTensor<B>>; 1] {
        let ([input], grad) = back.into_parts();
        [Some(composed::gradient::<B>(input, grad))]
    }
}

/// Each channel of each image (`[batch, channels, height, width]`) less its mean, over its standard deviation, then the
/// activation. Panics when there are no pixels.
pub fn instance_norm(input: Tensor<4>, activation: Activation) -> Tensor<4> {
    apply(InstanceNorm(activation), [input.into_dispatch()])
}
