//! The sequence loss of a single prediction.

use burn::tensor::Tensor;

use super::config::LossConfig;
use super::entry::Distance;
use super::inputs::{LossError, LossInputs, Prediction, sum};
use super::strain::strain;

/// The ground truth of a batch, prepared once for all predictions.
pub(super) struct Truth<'a> {
    config: &'a LossConfig,
    /// Zero at pixels that do not count: NaN times a weight of 0 would still be NaN.
    flow: Tensor<4>,
    /// Weights of the pixels, `[batch, 1, height, width]`.
    weight: Tensor<4>,
    /// 1 at pixels that count, `[batch, 1, height, width]`.
    counts: Tensor<4>,
}

impl<'a> Truth<'a> {
    pub(super) fn new(config: &'a LossConfig, inputs: &LossInputs) -> Self {
        let [batch, _, height, width] = inputs.truth.dims();
        // Comparisons with NaN are false, so an unknown flow never counts, whatever `valid` says.
        let magnitude = inputs.truth.clone().square().sum_dim(1).sqrt();
        let counts =
            inputs.valid.clone().greater_equal_elem(0.5).bool_and(magnitude.lower_elem(config.max_magnitude));
        let flow =
            inputs.truth.clone().mask_fill(counts.clone().bool_not().expand([batch, 2, height, width]), 0.0);
        let channels = config.sequence.channels as f64;
        let counts = counts.float();
        let weight = match config.sequence.distance {
            Distance::OfFlow(_) => counts.clone() / (channels * (batch * height * width) as f64),
            Distance::OfMixture(_) => {
                let counted = sum(counts.clone()).clamp_min(1.0) * channels;
                counts.clone() / counted.reshape([1, 1, 1, 1])
            }
        };
        Self { config, flow, weight, counts }
    }

    pub(super) fn strain(&self, prediction: &Prediction) -> Tensor<1> {
        strain(&(prediction.flow.clone() - self.flow.clone()), &self.counts)
    }

    pub(super) fn loss(&self, prediction: &Prediction) -> Result<Tensor<1>, LossError> {
        let difference = prediction.flow.clone() - self.flow.clone();
        let distance = match self.config.sequence.distance {
            Distance::OfFlow(distance) => distance(difference),
            Distance::OfMixture(distance) => {
                let mixture = prediction.mixture.as_ref().ok_or(LossError::NoMixture)?;
                distance(difference, mixture, self.config.log_scale_range)
            }
        };
        Ok(sum(distance * self.weight.clone()))
    }
}
