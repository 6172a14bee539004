//! Correlation lookup of RAFT (Teed and Deng 2020, section 3.2) without the all-pairs volume.
//!
//! RAFT computes the dot products of all pairs of pixels, pools them into a pyramid over the second image, and reads a window of
//! each level around the current estimate. Pooling the products is equivalent to pooling the second feature map, and only the
//! window is ever read; so the products are computed on demand. The result is the same, memory is that of the features, and
//! nothing grows with the square of the pixels. [`mod@reference`] is the definition.

#[cfg(feature = "cube")]
mod cube;
mod lookup;
mod pyramid;
pub mod reference;
pub mod tensor;

pub use lookup::{correlation_lookup, correlation_lookup_backward};
pub use pyramid::FeaturePyramid;

#[cfg(test)]
pub(crate) mod tests;
