//! Activations on tensors; on slices see [`srflow_simd::Activation`].

pub use srflow_simd::Activation;
pub(crate) use srflow_simd::{Keeps, activated, activation_backward};

mod composed;
pub mod tensor;

pub(crate) use composed::activate_tensor;

#[cfg(test)]
pub(crate) mod tests;
