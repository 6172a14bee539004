//! What is applied to a sum before it is stored, on tensors; on slices it is [`srflow_simd::Activation`].

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;
pub use srflow_simd::Activation;
pub(crate) use srflow_simd::{Keeps, activated, activation_backward};

pub mod tensor;

/// The activation by the backend's own operations.
pub(crate) fn activate_tensor<B: Backend>(x: FloatTensor<B>, activation: Activation) -> FloatTensor<B> {
    match activation {
        Activation::Identity => x,
        Activation::Relu => B::relu(x),
        Activation::Gelu => B::gelu(x),
        Activation::Tanh => B::float_tanh(x),
        Activation::Sigmoid => B::sigmoid(x),
    }
}
