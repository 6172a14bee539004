//! What training minimises: a sequence loss (RAFT's, SKFlow's, SEA-RAFT's) and the paper's four regularizers for skin.
//!
//! `docs/losses.md` says what the paper leaves open (image range, borders, reduction) and what is done here, and why.

mod config;
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

/// What a network gives after one iteration.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Flow in pixels, `[batch, 2, height, width]` (u, v).
    pub flow: Tensor<4>,
    /// How sure it is, for networks that say.
    pub mixture: Option<LaplaceMixture>,
}

impl Prediction {
    /// All flows of an estimate, the last one last.
    pub fn of(estimate: Estimate) -> Vec<Self> {
        let mixtures = estimate.mixtures.into_iter().map(Some).chain(std::iter::repeat(None));
        estimate.flows.into_iter().zip(mixtures).map(|(flow, mixture)| Self { flow, mixture }).collect()
    }
}

impl From<Tensor<4>> for Prediction {
    /// A flow alone.
    fn from(flow: Tensor<4>) -> Self {
        Self { flow, mixture: None }
    }
}

/// What a batch of predictions is held against. No gradient flows into any of it.
#[derive(Debug, Clone)]
pub struct LossInputs {
    /// True flow in pixels, `[batch, 2, height, width]` (u, v). It may be anything, NaN too, where it is not valid.
    pub truth: Tensor<4>,
    /// 1 where the true flow is known, else 0: `[batch, 1, height, width]`.
    pub valid: Tensor<4>,
    /// The first frame as the network sees it, RGB in 0..1: `[batch, 3, height, width]`.
    pub first_frame: Tensor<4>,
    /// `M_bg`: 1 on the head in the first frame, 0 on background, `[batch, 1, height, width]`. Without one, every pixel is
    /// of the head.
    pub foreground: Option<Tensor<4>>,
}

impl LossInputs {
    /// `M_bg` of zeros and ones.
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
    /// What to minimise: the sum of the parts.
    pub total: Tensor<1>,
    /// `sequence`, then each regularizer that is on by its [name](Regularizer::name), all as they enter the total.
    pub parts: Vec<(&'static str, Tensor<1>)>,
}

/// Why there is no loss.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LossError {
    #[error("loss.{key} = {found}: expected {expected}")]
    Setting { key: &'static str, found: String, expected: &'static str },
    /// The mixture of Laplace distributions was asked of a network that predicts none.
    #[error(
        "loss.sequence = \"mixture-of-laplace\" needs a network that predicts a mixture beside the flow, as SEA-RAFT does: \
         set it to \"l1\" or \"l2\", or train such a network"
    )]
    NoMixture,
}

/// The loss of the predictions of all iterations, the last one last: `sum_i gamma^(n - 1 - i) L(prediction i)` for the sequence
/// loss and each regularizer whose weight is not 0, times that weight.
///
/// The sequence loss of one prediction, over the pixels that are valid and whose true motion is shorter than
/// [`LossConfig::max_magnitude`]:
/// - L1: `|prediction - truth|` averaged over both components of all pixels of all images, those that do not count as 0;
/// - L2: the distance of the two, averaged over all pixels of all images, those that do not count as 0;
/// - mixture of Laplace: the negative log-likelihood averaged over both components of the pixels that count.
///
/// A batch in which no pixel counts has a sequence loss of 0 and no gradient.
///
/// # Errors
/// [`LossError::NoMixture`] when the predictions hold no mixture and the sequence loss needs one.
///
/// # Panics
/// When there is no prediction, or the tensors are empty or differ in size.
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
    let total = parts.iter().map(|(_, part)| part.clone()).reduce(|sum, part| sum + part);
    let total = total.expect("the sequence loss is there");
    Ok(Losses { total, parts })
}

/// Each regularizer that is on, of all predictions.
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

/// The weight of each pixel, `[batch, 1, height, width]`, and the logarithm of the base, `[batch, 1, 1, 1]`.
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

/// The sum of all elements, row by row: in an order that does not depend on the threads.
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
