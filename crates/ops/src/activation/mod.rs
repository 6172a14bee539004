//! What is applied to a sum before it is stored, on tensors; on slices it is [`srflow_simd::Activation`].

pub use srflow_simd::Activation;
pub(crate) use srflow_simd::{Keeps, activated, activation_backward};

mod composed;
pub mod tensor;

pub(crate) use composed::activate_tensor;

#[cfg(test)]
pub(crate) mod tests;
