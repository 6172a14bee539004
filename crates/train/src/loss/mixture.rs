//! Losses with a mixture of Laplace distributions (Wang, Lipson and Deng, *SEA-RAFT*, ECCV 2024, section 3.2).

use burn::tensor::Tensor;
use srflow_nets::LaplaceMixture;
use srflow_ops::laplace_mixture::{LogScaleRange, tensor};

use super::entry::{Distance, SequenceLoss};

pub(super) const MIXTURE_OF_LAPLACE: SequenceLoss = SequenceLoss {
    name: "mixture-of-laplace",
    description: "negative log-likelihood under two Laplace distributions that the network predicts; SEA-RAFT's",
    distance: Distance::OfMixture(negative_log_likelihood),
    channels: 2,
};

/// With scales below a pixel, the likelihood would weight pixels by their certainty, and so neglect hair and outlines.
pub(super) const L1_AND_MIXTURE: SequenceLoss = SequenceLoss {
    name: "l1-and-mixture",
    description: "absolute difference of the components, from which the flow learns, and a fifth of the negative \
                  log-likelihood of that difference, from which the mixture learns",
    distance: Distance::OfMixture(|difference, mixture, range| {
        let likelihood = negative_log_likelihood(difference.clone().detach(), mixture, range);
        difference.abs() + likelihood * MIXTURE_SHARE
    }),
    channels: 2,
};

/// Keeps the layers that flow and mixture share to the flow.
const MIXTURE_SHARE: f64 = 0.2;

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
