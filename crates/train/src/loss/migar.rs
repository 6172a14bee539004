//! Mean Image Gradient Activation Regularization (the paper's section IV-B3).

use burn::tensor::Tensor;

/// The logarithm of the base of the weights, the paper's equation 14: the mean over all pixels of each image of `gradient` (`G`,
/// `[batch, 1, height, width]`). As `[batch, 1, 1, 1]`.
pub(super) fn log_base(gradient: Tensor<4>) -> Tensor<4> {
    gradient.mean_dims(&[2, 3])
}
