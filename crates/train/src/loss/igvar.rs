//! Image Gradient Variance Activation Regularization (the paper's section IV-B4).

use burn::tensor::Tensor;

use super::table::{Regularizer, RegularizerValue};

pub(super) const REGULARIZER: Regularizer = Regularizer {
    name: "igvar",
    title: "IGVAR",
    paper_weight: 1.0,
    description: "as MIGAR, base from the variance of the gradient on the head",
    value: RegularizerValue::WeightedVariation { log_base },
};

/// The logarithm of the base of the weights, the paper's equation 19: `base = max(Var(G) / 100, e)`, the variance over the pixels of
/// each image at which `foreground` is 1. Both `[batch, 1, height, width]`; the result is `[batch, 1, 1, 1]`.
///
/// The variance is that of a whole population (divided by the number of pixels), so that one pixel has one; no pixel at all
/// has variance 0, which makes the base `e`.
fn log_base(gradient: Tensor<4>, foreground: &Tensor<4>) -> Tensor<4> {
    let count = foreground.clone().sum_dims(&[2, 3]).clamp_min(1.0);
    let mean = |x: Tensor<4>| (x * foreground.clone()).sum_dims(&[2, 3]) / count.clone();
    let deviation = gradient.clone() - mean(gradient);
    (mean(deviation.square()) / 100.0).log().clamp_min(1.0)
}
