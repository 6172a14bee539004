//! Training losses: a sequence loss (RAFT's, SKFlow's, SEA-RAFT's) and the paper's four regularizers for skin.
//!
//! `docs/explanation/losses.md` explains the choices that the paper leaves open (image range, borders, reduction).

mod config;
pub(crate) mod cyclic;
mod entry;
mod fdr;
mod igvar;
mod inputs;
mod l1;
mod l2;
mod migar;
mod mixture;
mod of_flow;
mod sequence;
mod sobel;
pub(crate) mod strain;
mod table;
mod tvr;
mod weighted_variation;

use burn::tensor::Tensor;

pub use config::{LossConfig, REGULARIZERS};
pub use entry::{Border, MaskReading, Regularizer, SequenceLoss};
pub use inputs::{LossError, LossInputs, Prediction};
pub use of_flow::{FlowRegularizer, ImageWeights, RegularizerError, regularizers_of_flow};
pub use table::SEQUENCE_LOSSES;

use entry::RegularizerValue;
use weighted_variation::{pixel_weights, total_mask, weighted_variation};

/// The loss of a batch.
#[derive(Debug, Clone)]
pub struct Losses {
    /// The sum of the parts, to minimise.
    pub total: Tensor<1>,
    /// `sequence`, then each active regularizer by [name](Regularizer::name), then `strain` and `cyclic` if active, weighted as in the total.
    pub parts: Vec<(&'static str, Tensor<1>)>,
}

/// The loss of the predictions of all iterations, in order: `sum_i gamma^(n - 1 - i) L(prediction i)` for the sequence loss, and
/// for each active regularizer, the strain loss and the cyclic loss, times its weight.
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
    if config.strain != 0.0 {
        let of = predictions.iter().map(|prediction| truth.strain(prediction));
        parts.push((strain::NAME, over_iterations(config.gamma, of) * config.strain));
    }
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

/// `sum_i gamma^(n - 1 - i) loss_i`.
fn over_iterations(gamma: f64, losses: impl IntoIterator<Item = Tensor<1>>) -> Tensor<1> {
    losses.into_iter().reduce(|sum, loss| sum * gamma + loss).expect("a loss needs a prediction")
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
