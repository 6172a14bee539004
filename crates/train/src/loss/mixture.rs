//! The mixture-of-Laplace loss (Wang, Lipson and Deng, *SEA-RAFT*, ECCV 2024, section 3.2).

use burn::tensor::Tensor;
use srflow_nets::LaplaceMixture;

use super::table::{Distance, SequenceLoss};

pub(super) const MIXTURE_OF_LAPLACE: SequenceLoss = SequenceLoss {
    name: "mixture-of-laplace",
    description: "negative log-likelihood under two Laplace distributions that the network predicts; SEA-RAFT's",
    distance: Distance::OfMixture(negative_log_likelihood),
    channels: 2,
};

/// `-ln p(difference)` for each component of the flow, `[batch, 2, height, width]`, where
/// `p(d) = sum_k w_k / (2 b_k) exp(-|d| / b_k)`. Both components of the flow share the weights `w` and the scales `b`.
fn negative_log_likelihood(
    difference: Tensor<4>,
    mixture: &LaplaceMixture,
    log_scale_range: [f64; 2],
) -> Tensor<4> {
    let distance = difference.abs();
    let component = |k: usize, log_scale: Tensor<4>| {
        let log_weight = mixture.log_weights.clone().narrow(1, k, 1);
        let log_peak = log_weight.clone() - log_scale.clone() - std::f64::consts::LN_2;
        (log_weight, log_peak - distance.clone() * (-log_scale).exp())
    };
    let [wide, narrow] = mixture.limited_log_scales(log_scale_range);
    let (wide_weight, wide) = component(0, wide);
    let (narrow_weight, narrow) = component(1, narrow);
    log_sum_exp(wide_weight, narrow_weight) - log_sum_exp(wide, narrow)
}

/// `ln(e^a + e^b)` without overflow, and differentiable at `a = b`.
fn log_sum_exp(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    let apart = (a.clone() - b.clone()).abs();
    (a + b + apart.clone()) * 0.5 + (-apart).exp().log1p()
}
