//! The output of the encoders for a pair of frames.

use burn::tensor::Tensor;

/// What the encoders give to the refinements. With [`Request::encoded`](crate::Request::encoded) a network skips its encoders and
/// refines from any state between two iterations, as training with recomputation does.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// The hidden state before the first refinement, `[batch, channels, height / 8, width / 8]`.
    pub hidden: Tensor<4>,
    /// What stays the same in every refinement.
    pub context: Tensor<4>,
    /// Features of the first and of the second frames.
    pub features: [Tensor<4>; 2],
}
