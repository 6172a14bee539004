//! Image Gradient Variance Activation Regularization (the paper's section IV-B4).

use burn::tensor::Tensor;

use super::entry::{Regularizer, RegularizerValue};

pub(super) const REGULARIZER: Regularizer = Regularizer {
    name: "igvar",
    title: "IGVAR",
    paper_weight: 1.0,
    description: "as MIGAR, base from the variance of the gradient on the head",
    value: RegularizerValue::WeightedVariation { log_base },
};

/// Logarithm of the base of the weights, `[batch, 1, 1, 1]`, by the paper's equation 19: `base = max(Var(G) / 100, e)`, where the
/// variance is over the pixels of each image with `foreground` 1. Both inputs are `[batch, 1, height, width]`.
///
/// It is the population variance (divided by the number of pixels), which is defined for a single pixel. Without any pixel it is
/// 0, and the base `e`.
fn log_base(gradient: Tensor<4>, foreground: &Tensor<4>) -> Tensor<4> {
    let count = foreground.clone().sum_dims(&[2, 3]).clamp_min(1.0);
    let mean = |x: Tensor<4>| (x * foreground.clone()).sum_dims(&[2, 3]) / count.clone();
    let deviation = gradient.clone() - mean(gradient);
    (mean(deviation.square()) / 100.0).log().clamp_min(1.0)
}
