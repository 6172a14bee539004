//! What training minimises: a sequence loss (RAFT's, SKFlow's, SEA-RAFT's) and the paper's four regularizers for skin.
//!
//! `docs/losses.md` says what the paper leaves open (image range, borders, reduction) and what is done here, and why.

mod config;
mod fdr;
mod igvar;
mod migar;
mod mixture;
mod sequence;
mod sobel;
mod tvr;
mod weighted_variation;

use burn::tensor::Tensor;

pub use config::{Border, LossConfig, MaskReading, Regularizer, SequenceKind};
pub use mixture::LaplaceMixture;

use fdr::flow_difference;
use tvr::total_variation;
use weighted_variation::{gradient_magnitude, total_mask, weighted_variation};

/// What a network gives after one iteration.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Flow in pixels, `[batch, 2, height, width]` (u, v).
    pub flow: Tensor<4>,
    /// How sure it is, for networks that say.
    pub mixture: Option<LaplaceMixture>,
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
    /// A number of the configuration makes no sense.
    #[error("loss.{key} = {found}: expected {expected}")]
    Setting {
        /// The key in the configuration.
        key: &'static str,
        /// Its value.
        found: String,
        /// What it may be.
        expected: &'static str,
    },
    /// The mixture of Laplace distributions was asked of a network that predicts none.
    #[error(
        "loss.sequence = \"mixture-of-laplace\" needs a network that predicts how sure it is (SEA-RAFT); this one gives \
         flow alone: set it to \"l1\" or \"l2\""
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
    let sequence = over_predictions(config.gamma, predictions, |prediction| truth.loss(prediction))?;
    let mut parts = vec![("sequence", sequence)];
    parts.extend(regularizers(config, predictions, inputs)?);
    let total = parts.iter().map(|(_, part)| part.clone()).reduce(|sum, part| sum + part);
    let total = total.expect("the sequence loss is there");
    Ok(Losses { total, parts })
}

/// Each regularizer that is on, of all predictions.
fn regularizers(
    config: &LossConfig,
    predictions: &[Prediction],
    inputs: &LossInputs,
) -> Result<Vec<(&'static str, Tensor<1>)>, LossError> {
    let [batch, _, height, width] = inputs.truth.dims();
    let border = config.border;
    let foreground = match &inputs.foreground {
        Some(mask) => mask.clone().greater_elem(0.5).float(),
        None => Tensor::ones([batch, 1, height, width], &inputs.truth.device()),
    };
    let gradient = || gradient_magnitude(inputs.first_frame.clone() * config.image_max, border);
    let mut parts = Vec::new();
    for regularizer in Regularizer::ALL {
        let weight = config.weight(regularizer);
        if weight == 0.0 {
            continue;
        }
        let weighted = |weights: Tensor<4>| {
            let mask = total_mask(foreground.clone(), config.m_total, border);
            over_predictions(config.gamma, predictions, move |prediction| {
                let flow = prediction.flow.clone();
                Ok(weighted_variation(flow, mask.clone(), weights.clone(), border))
            })
        };
        let part = match regularizer {
            Regularizer::Tvr => over_predictions(config.gamma, predictions, |prediction| {
                Ok(total_variation(prediction.flow.clone(), border))
            }),
            Regularizer::Fdr => over_predictions(config.gamma, predictions, |prediction| {
                Ok(flow_difference(prediction.flow.clone(), foreground.clone()))
            }),
            Regularizer::Migar => weighted(migar::weights(gradient())),
            Regularizer::Igvar => weighted(igvar::weights(gradient(), foreground.clone())),
        };
        parts.push((regularizer.name(), part? * weight));
    }
    Ok(parts)
}

/// `sum_i gamma^(n - 1 - i) loss(prediction i)`.
fn over_predictions(
    gamma: f64,
    predictions: &[Prediction],
    loss: impl Fn(&Prediction) -> Result<Tensor<1>, LossError>,
) -> Result<Tensor<1>, LossError> {
    let [first, rest @ ..] = predictions else { panic!("a loss needs a prediction") };
    rest.iter().try_fold(loss(first)?, |sum, prediction| Ok(sum * gamma + loss(prediction)?))
}

/// The sum of all elements, row by row: in an order that does not depend on the threads.
fn sum(x: Tensor<4>) -> Tensor<1> {
    x.sum_dim(3).sum()
}

fn check_sizes(predictions: &[Prediction], inputs: &LossInputs) {
    let [batch, _, height, width] = inputs.truth.dims();
    assert!(batch * height * width > 0, "a loss needs a pixel");
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
