//! Mean Image Gradient Activation Regularization (the paper's section IV-B3).

use burn::tensor::Tensor;

use super::entry::{Regularizer, RegularizerValue};

pub(super) const REGULARIZER: Regularizer = Regularizer {
    name: "migar",
    title: "MIGAR",
    paper_weight: 1.0,
    description: "variation inside the head, less where the frame has edges; base from the mean of its gradient",
    value: RegularizerValue::WeightedVariation { log_base },
};

/// Logarithm of the base of the weights, `[batch, 1, 1, 1]`, by the paper's equation 14: the mean of `gradient` (`G`,
/// `[batch, 1, height, width]`) over all pixels of each image.
fn log_base(gradient: Tensor<4>, _: &Tensor<4>) -> Tensor<4> {
    gradient.mean_dims(&[2, 3])
}
