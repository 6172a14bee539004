//! Mean Image Gradient Activation Regularization (the paper's section IV-B3, equations 14 and 15).

use burn::tensor::Tensor;

/// `w = base^-G` with `base = exp(mean G)`, the mean over all pixels of an image, from `G` (`[batch, 1, height, width]`).
/// Computed as `exp(-G mean G)`: with frames in 0..255 the base itself overflows `f32` where the mean is above 88. A
/// weight below 1e-45 is zero.
pub(super) fn weights(gradient: Tensor<4>) -> Tensor<4> {
    let log_base = gradient.clone().mean_dims(&[2, 3]);
    (-gradient * log_base).exp()
}
