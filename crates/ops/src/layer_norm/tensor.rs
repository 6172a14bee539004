//! The normalization on tensors: [`layer_norm`] with its gradient.

use burn::tensor::Tensor;

use crate::Activation;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct LayerNorm(pub(super) Activation);

impl Operation<1> for LayerNorm {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.0)
    }

    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        vec![input.like(super::layer_norm(input.slice(), &input.map_shape(), self.0))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        [Some(input.like(super::layer_norm_backward(input.slice(), grad.slice(), &input.map_shape())))]
    }
}

/// The channels of each pixel (`[batch, channels, height, width]`) less their mean, over their standard deviation, then the
/// activation. Panics when there are no pixels or channels.
pub fn layer_norm(input: Tensor<4>, activation: Activation) -> Tensor<4> {
    apply(LayerNorm(activation), [input.into_dispatch()])
}
