//! Tensor operations that Burn lacks or does slowly. Each has a readable twin that defines it, a fast CPU version and a
//! backward.

mod shared_mut;
mod simd;

pub mod conv2d;
