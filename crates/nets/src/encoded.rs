//! What a network makes of two frames before it refines anything.

use burn::tensor::Tensor;

/// What refinements start from and read: with [`Request::encoded`](crate::Request::encoded) a network refines without the
/// encoders, from any state between two iterations. Training recomputes single refinements so.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// The hidden state before the first refinement, `[batch, channels, height / 8, width / 8]`.
    pub hidden: Tensor<4>,
    /// What stays the same in every refinement.
    pub context: Tensor<4>,
    /// Features of the first and of the second frames.
    pub features: [Tensor<4>; 2],
}
