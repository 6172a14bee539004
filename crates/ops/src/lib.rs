//! Tensor operations that Burn lacks or runs slowly.
//!
//! Each is a module: its definition as slow, readable code (`reference`), the fast CPU version and its backward on slices, and the
//! operation on Burn's tensors with gradients (`tensor`), which `operation.rs` runs on every device.

// Kernels walk several arrays in step by one index, as their equations do.
#![allow(clippy::needless_range_loop)]

mod concatenate;
#[cfg(feature = "cube")]
mod cube;
mod device;
mod flex;
mod map_shape;
mod operation;
mod precision;
mod reusing_allocator;
mod scoped;
mod sums;
#[cfg(test)]
mod test_values;
mod weight_cache;

pub use activation::Activation;
pub use burn::tensor::Device;
pub use concatenate::concatenate;
pub use device::device;
pub use map_shape::MapShape;
pub use precision::{
    Precision, PrecisionError, check_precision, fastest_precision, precision, precisions, with_precision,
};
pub use reusing_allocator::ReusingAllocator;
pub use srflow_simd::{DeviceError, device_kinds};
pub use weight_cache::WeightCache;

pub mod activation;
pub mod attention;
pub mod batch_norm;
pub mod conv2d;
pub mod conv_transpose2d;
pub mod convolution;
pub mod correlation;
pub mod depthwise;
#[cfg(feature = "golden")]
pub mod golden;
pub mod gru;
pub mod instance_norm;
pub mod laplace_mixture;
pub mod layer_norm;
pub mod lucas_kanade;
pub mod max_pool;
pub mod pointwise;
pub mod resize;
pub mod space_to_depth;
pub mod upsample;
pub mod warp;
