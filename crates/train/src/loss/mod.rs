//! Training losses: a sequence loss (RAFT's, SKFlow's, SEA-RAFT's) and the paper's four regularizers for skin.
//!
//! `docs/explanation/losses.md` explains the choices that the paper leaves open (image range, borders, reduction).

mod config;
pub(crate) mod cyclic;
mod fdr;
mod igvar;
mod migar;
mod mixture;
mod of_flow;
mod sequence;
mod sobel;
mod table;
mod tvr;
mod weighted_variation;

use burn::tensor::Tensor;
use srflow_nets::{Estimate, LaplaceMixture};

pub use config::{Border, LossConfig, MaskReading, REGULARIZERS};
pub use of_flow::{FlowRegularizer, ImageWeights, RegularizerError, regularizers_of_flow};
pub use table::{Regularizer, SEQUENCE_LOSSES, SequenceLoss};

use table::RegularizerValue;
use weighted_variation::{gradient_magnitude, total_mask, weighted_variation, weights};

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
    fn foreground_or_all(&self) -> Tensor<4> {
        match &self.foreground {
            Some(mask) => mask.clone().greater_elem(0.5).float(),
            None => Tensor::ones(self.valid.dims(), &self.valid.device()),
        }
    }
}

/// The loss of a batch.
#[derive(Debug, Clone)]
pub struct Losses {
    /// The sum of the parts, to minimise.
    pub total: Tensor<1>,
    /// `sequence`, then each active regularizer by [name](Regularizer::name), and `cyclic` if active, weighted as in the total.
    pub parts: Vec<(&'static str, Tensor<1>)>,
}

/// Errors of computing a loss.
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

/// The loss of the predictions of all iterations, in order: `sum_i gamma^(n - 1 - i) L(prediction i)` for the sequence loss, and
/// for each active regularizer and the cyclic loss, times its weight.
///
/// The sequence loss of one prediction is, where pixels count if they are valid and their true motion is shorter than
/// [`LossConfig::max_magnitude`]:
/// - L1: `|prediction - truth|`, averaged over both components of all pixels; pixels that do not count contribute 0;
/// - L2: the end-point error, averaged over all pixels; pixels that do not count contribute 0;
/// - mixture of Laplace: the negative log-likelihood, averaged over both components of the pixels that count.
///
/// If no pixel of the batch counts, sequence loss and gradient are 0.
///
/// # Errors
/// [`LossError::NoMixture`] when the sequence loss needs a mixture that the predictions lack.
///
/// # Panics
/// Without predictions, or when tensors are empty or differ in size.
pub fn losses(
    config: &LossConfig,
    predictions: &[Prediction],
    inputs: &LossInputs,
) -> Result<Losses, LossError> {
    check_sizes(predictions, inputs);
    let truth = sequence::Truth::new(config, inputs);
    let sequence =
        predictions.iter().map(|prediction| truth.loss(prediction)).collect::<Result<Vec<_>, _>>()?;
    let mut parts = vec![("sequence", over_iterations(config.gamma, sequence))];
    parts.extend(regularizers(config, predictions, inputs));
    if config.cyclic != 0.0 {
        let of = |prediction: &Prediction| cyclic::cyclic(prediction.flow.clone(), inputs, config.image_max);
        parts.push((cyclic::NAME, over_iterations(config.gamma, predictions.iter().map(of)) * config.cyclic));
    }
    let total = parts.iter().map(|(_, part)| part.clone()).reduce(|sum, part| sum + part);
    let total = total.expect("at least the sequence loss");
    Ok(Losses { total, parts })
}

/// The active regularizers over all predictions, weighted.
fn regularizers(
    config: &LossConfig,
    predictions: &[Prediction],
    inputs: &LossInputs,
) -> Vec<(&'static str, Tensor<1>)> {
    let border = config.border;
    let foreground = inputs.foreground_or_all();
    let part = |regularizer: &'static Regularizer| {
        let over_flows = |value: &dyn Fn(Tensor<4>) -> Tensor<1>| {
            over_iterations(config.gamma, predictions.iter().map(|prediction| value(prediction.flow.clone())))
        };
        let value = match regularizer.value {
            RegularizerValue::OfFlow(value) => over_flows(&|flow| value(flow, &foreground, border)),
            RegularizerValue::WeightedVariation { log_base } => {
                let mask = total_mask(foreground.clone(), config.m_total, border);
                let (weights, _) = pixel_weights(log_base, config, &inputs.first_frame, &foreground);
                over_flows(&|flow| weighted_variation(flow, mask.clone(), weights.clone(), border))
            }
        };
        (regularizer.name, value * config.weight(regularizer))
    };
    REGULARIZERS.iter().filter(|regularizer| config.weight(regularizer) != 0.0).map(part).collect()
}

/// Weights of the pixels, `[batch, 1, height, width]`, and the logarithm of their base, `[batch, 1, 1, 1]`.
fn pixel_weights(
    log_base: fn(Tensor<4>, &Tensor<4>) -> Tensor<4>,
    config: &LossConfig,
    first_frame: &Tensor<4>,
    foreground: &Tensor<4>,
) -> (Tensor<4>, Tensor<4>) {
    let gradient = gradient_magnitude(first_frame.clone(), config.border) * config.image_max;
    let log_base = log_base(gradient.clone(), foreground);
    (weights(gradient, log_base.clone()), log_base)
}

/// `sum_i gamma^(n - 1 - i) loss_i`.
fn over_iterations(gamma: f64, losses: impl IntoIterator<Item = Tensor<1>>) -> Tensor<1> {
    losses.into_iter().reduce(|sum, loss| sum * gamma + loss).expect("a loss needs a prediction")
}

/// The sum of all elements. Row sums first make the order, and so the rounding, independent of the number of threads.
fn sum(x: Tensor<4>) -> Tensor<1> {
    x.sum_dim(3).sum()
}

fn check_sizes(predictions: &[Prediction], inputs: &LossInputs) {
    let [batch, _, height, width] = inputs.truth.dims();
    assert!(batch * height * width > 0, "a loss needs a pixel");
    assert!(!predictions.is_empty(), "a loss needs a prediction");
    let check = |name: &str, tensor: &Tensor<4>, channels: usize| {
        assert_eq!(tensor.dims(), [batch, channels, height, width], "the size of {name}");
    };
    check("the truth", &inputs.truth, 2);
    check("the valid pixels", &inputs.valid, 1);
    check("the first frame", &inputs.first_frame, 3);
    check("the second frame", &inputs.second_frame, 3);
    if let Some(mask) = &inputs.foreground {
        check("the foreground", mask, 1);
    }
    for prediction in predictions {
        check("a prediction", &prediction.flow, 2);
        if let Some(mixture) = &prediction.mixture {
            check("the mixture's weights", &mixture.log_weights, 2);
            check("the mixture's scales", &mixture.log_scales, 2);
        }
    }
}
