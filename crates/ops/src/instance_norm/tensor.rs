//! The normalizations on tensors: [`instance_norm`] and [`group_norm`] with their gradients.

use burn::tensor::Tensor;
#[cfg(feature = "cube")]
use burn_cubecl::{CubeBackend, tensor::CubeTensor};

use super::EPSILON;
use crate::Activation;
#[cfg(feature = "cube")]
use crate::activation::activate_tensor;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct InstanceNorm {
    pub(super) epsilon: f64,
    pub(super) activation: Activation,
}

impl Operation<1> for InstanceNorm {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.activation)
    }

    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        let pixels = input.map_shape().pixels();
        vec![input.like(super::instance_norm(input.slice(), pixels, self.epsilon, self.activation))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        let pixels = input.map_shape().pixels();
        [Some(input.like(super::instance_norm_backward(input.slice(), grad.slice(), pixels, self.epsilon)))]
    }

    #[cfg(feature = "cube")]
    fn cube(&self, [input]: [CubeTensor; 1]) -> Vec<CubeTensor> {
        let (below, then) = match self.activation {
            Activation::Identity => (1.0, Activation::Identity),
            Activation::Relu => (0.0, Activation::Identity),
            Activation::LeakyRelu => (Activation::LEAK, Activation::Identity),
            other => (1.0, other),
        };
        let normal = super::cube::instance_norm(input, self.epsilon, below);
        vec![activate_tensor::<CubeBackend>(normal, then)]
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; 1] {
        let ([input], grad) = back.into_parts();
        [Some(super::cube::instance_norm_backward(input, grad, self.epsilon))]
    }
}

/// Each channel of each image (`[batch, channels, height, width]`) less its mean, over its standard deviation, then the
/// activation. Panics when there are no pixels.
pub fn instance_norm(input: Tensor<4>, activation: Activation) -> Tensor<4> {
    apply(InstanceNorm { epsilon: EPSILON, activation }, [input.into_dispatch()])
}

/// As many `groups` of neighbouring channels, each less its mean over channels and pixels, over its standard deviation, with
/// `epsilon` added to the variance, then the activation. Panics when there are no pixels or the channels are not whole groups.
pub fn group_norm(input: Tensor<4>, groups: usize, epsilon: f64, activation: Activation) -> Tensor<4> {
    let dims @ [batch, channels, height, width] = input.dims();
    assert!(groups > 0 && channels.is_multiple_of(groups), "{channels} channels in {groups} groups");
    let planes = input.reshape([batch, groups, channels / groups * height, width]);
    apply::<_, 1, 4>(InstanceNorm { epsilon, activation }, [planes.into_dispatch()]).reshape(dims)
}
