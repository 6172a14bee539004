//! The mixture-of-Laplace loss (Wang, Lipson and Deng, *SEA-RAFT*, ECCV 2024, section 3.2).

use burn::tensor::Tensor;
use srflow_nets::LaplaceMixture;
use srflow_ops::laplace_mixture::{LogScaleRange, tensor};

use super::table::{Distance, SequenceLoss};

pub(super) const MIXTURE_OF_LAPLACE: SequenceLoss = SequenceLoss {
    name: "mixture-of-laplace",
    description: "negative log-likelihood under two Laplace distributions that the network predicts; SEA-RAFT's",
    distance: Distance::OfMixture(negative_log_likelihood),
    channels: 2,
};

/// See [`srflow_ops::laplace_mixture::negative_log_likelihood`].
fn negative_log_likelihood(
    difference: Tensor<4>,
    mixture: &LaplaceMixture,
    [low, high]: [f64; 2],
) -> Tensor<4> {
    let LaplaceMixture { log_weights, log_scales } = mixture.clone();
    let range = LogScaleRange { low: low as f32, high: high as f32 };
    tensor::negative_log_likelihood(difference, log_weights, log_scales, range)
}
