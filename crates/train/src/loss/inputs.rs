//! What losses are computed from.

use burn::tensor::Tensor;
use srflow_nets::{Estimate, LaplaceMixture};

/// The prediction of a network after one iteration.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Flow in pixels, `[batch, 2, height, width]` (u, v).
    pub flow: Tensor<4>,
    /// The distribution of the error of the flow, if the network predicts it.
    pub mixture: Option<LaplaceMixture>,
}

impl Prediction {
    /// The predictions of all iterations, in order.
    pub fn of(estimate: Estimate) -> Vec<Self> {
        let mixtures = estimate.mixtures.into_iter().map(Some).chain(std::iter::repeat(None));
        estimate.flows.into_iter().zip(mixtures).map(|(flow, mixture)| Self { flow, mixture }).collect()
    }
}

impl From<Tensor<4>> for Prediction {
    fn from(flow: Tensor<4>) -> Self {
        Self { flow, mixture: None }
    }
}

/// Targets of the loss. No gradients flow into them.
#[derive(Debug, Clone)]
pub struct LossInputs {
    /// True flow in pixels, `[batch, 2, height, width]` (u, v). Values of invalid pixels are ignored and may be NaN.
    pub truth: Tensor<4>,
    /// 1 where the true flow is known, else 0: `[batch, 1, height, width]`.
    pub valid: Tensor<4>,
    /// The first frame as the network sees it, RGB in 0..1: `[batch, 3, height, width]`.
    pub first_frame: Tensor<4>,
    /// The second frame, like the first.
    pub second_frame: Tensor<4>,
    /// `M_bg`: 1 on the head in the first frame, 0 on the background, `[batch, 1, height, width]`. `None` counts every pixel as
    /// head.
    pub foreground: Option<Tensor<4>>,
}

impl LossInputs {
    /// `M_bg`, rounded to zeros and ones.
    pub(super) fn foreground_or_all(&self) -> Tensor<4> {
        match &self.foreground {
            Some(mask) => mask.clone().greater_elem(0.5).float(),
            None => Tensor::ones(self.valid.dims(), &self.valid.device()),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LossError {
    #[error("loss.{key} = {found}: expected {expected}")]
    Setting { key: &'static str, found: String, expected: &'static str },
    #[error(
        "loss.sequence = \"mixture-of-laplace\" needs a network that also predicts a mixture, such as SEA-RAFT: set it to \
         \"l1\" or \"l2\", or train such a network"
    )]
    NoMixture,
}

/// The sum of all elements. Row sums first make the order, and so the rounding, independent of the number of threads.
pub(super) fn sum(x: Tensor<4>) -> Tensor<1> {
    x.sum_dim(3).sum()
}
