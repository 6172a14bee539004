//! Tensor operations that Burn lacks or does slowly.
//!
//! Each is a module of its own: a readable twin that defines it (`reference`), the fast CPU version and its backward on
//! plain slices, and the operation on Burn's tensors with gradients (`tensor`).

// Kernels walk several arrays in step by one index, as their equations do.
#![allow(clippy::needless_range_loop)]

mod activation;
mod device;
mod flex;
mod shared_mut;
mod simd;
#[cfg(test)]
mod test_values;

pub use activation::Activation;
pub use device::{DeviceError, device, device_kinds};

pub mod conv2d;
pub mod correlation;
pub mod depthwise;
pub mod instance_norm;
pub mod upsample;
pub mod warp;
