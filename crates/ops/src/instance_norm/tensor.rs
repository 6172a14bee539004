//! The normalization on tensors: [`instance_norm`] with its gradient.

use burn::tensor::Tensor;

use crate::Activation;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct InstanceNorm(pub(super) Activation);

impl Operation<1> for InstanceNorm {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.0)
    }

    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        vec![input.like(super::instance_norm(input.slice(), input.map_shape().pixels(), self.0))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        [Some(input.like(super::instance_norm_backward(
            input.slice(),
            grad.slice(),
            input.map_shape().pixels(),
        )))]
    }
}

/// Each channel of each image (`[batch, channels, height, width]`) less its mean, over its standard deviation, then the
/// activation. Panics when there are no pixels.
pub fn instance_norm(input: Tensor<4>, activation: Activation) -> Tensor<4> {
    apply(InstanceNorm(activation), [input.into_dispatch()])
}
