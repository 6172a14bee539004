//! The sequence loss of one prediction.

use burn::tensor::Tensor;

use super::mixture::{LaplaceMixture, negative_log_likelihood};
use super::{LossConfig, LossError, LossInputs, Prediction, SequenceKind, sum};

/// The truth of a batch, made ready once for all predictions.
pub(super) struct Truth {
    kind: SequenceKind,
    log_scale_range: [f64; 2],
    /// Zero where it does not count, so that an unknown (NaN) flow harms nothing.
    flow: Tensor<4>,
    /// What a pixel counts, `[batch, 1, height, width]`.
    weight: Tensor<4>,
}

impl Truth {
    pub(super) fn new(config: &LossConfig, inputs: &LossInputs) -> Self {
        let [batch, _, height, width] = inputs.truth.dims();
        // NaN is below nothing: an unknown flow does not count, whatever `valid` says.
        let magnitude = inputs.truth.clone().square().sum_dim(1).sqrt();
        let counts =
            inputs.valid.clone().greater_equal_elem(0.5).bool_and(magnitude.lower_elem(config.max_magnitude));
        let flow =
            inputs.truth.clone().mask_fill(counts.clone().bool_not().expand([batch, 2, height, width]), 0.0);
        let pixels = (batch * height * width) as f64;
        let counts = counts.float();
        let weight = match config.sequence {
            SequenceKind::L1 => counts / (2.0 * pixels),
            SequenceKind::L2 => counts / pixels,
            SequenceKind::MixtureOfLaplace => {
                let counted = sum(counts.clone()).clamp_min(1.0) * 2.0;
                counts / counted.reshape([1, 1, 1, 1])
            }
        };
        Self { kind: config.sequence, log_scale_range: config.log_scale_range, flow, weight }
    }

    /// The sequence loss of one prediction.
    pub(super) fn loss(&self, prediction: &Prediction) -> Result<Tensor<1>, LossError> {
        let difference = prediction.flow.clone() - self.flow.clone();
        let loss = match self.kind {
            SequenceKind::L1 => difference.abs(),
            // The distance has no gradient at zero: below a millionth of a pixel it is held constant.
            SequenceKind::L2 => difference.square().sum_dim(1).clamp_min(1e-12).sqrt(),
            SequenceKind::MixtureOfLaplace => {
                let mixture = prediction.mixture.as_ref().ok_or(LossError::NoMixture)?;
                self.likelihood(difference, mixture)
            }
        };
        Ok(sum(loss * self.weight.clone()))
    }

    fn likelihood(&self, difference: Tensor<4>, mixture: &LaplaceMixture) -> Tensor<4> {
        negative_log_likelihood(difference, mixture, self.log_scale_range)
    }
}
