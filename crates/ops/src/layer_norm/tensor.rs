//! The normalization on tensors: [`layer_norm`] with its gradient.

use burn::tensor::Tensor;

use crate::Activation;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct LayerNorm {
    pub(super) epsilon: f64,
    pub(super) activation: Activation,
}

impl Operation<1> for LayerNorm {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.activation)
    }

    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        vec![input.like(super::layer_norm(input.slice(), &input.map_shape(), self.epsilon, self.activation))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        let shape = input.map_shape();
        [Some(input.like(super::layer_norm_backward(input.slice(), grad.slice(), &shape, self.epsilon)))]
    }
}

/// The channels of each pixel (`[batch, channels, height, width]`) less their mean, over the root of their variance and
/// `epsilon`, then the activation. Panics when there are no pixels or channels.
pub fn layer_norm(input: Tensor<4>, epsilon: f64, activation: Activation) -> Tensor<4> {
    apply(LayerNorm { epsilon, activation }, [input.into_dispatch()])
}
