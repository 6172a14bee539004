//! Tensor operations that Burn lacks or does slowly. Each has a readable twin that defines it, a fast CPU version and a
//! backward.

mod activation;
mod shared_mut;
mod simd;
#[cfg(test)]
mod test_values;

pub use activation::Activation;

pub mod conv2d;
pub mod correlation;
pub mod depthwise;
