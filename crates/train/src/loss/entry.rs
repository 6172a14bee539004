//! What a loss is: an entry of the tables that configuration, ablation, log, `srflow metrics --regularizers` and
//! `docs/explanation/losses.md` read.

use std::fmt;

use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};
use srflow_nets::LaplaceMixture;

/// Reading of the paper's formula of `M_total` (equation 16).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaskReading {
    /// The head pixels where the gradient of the mask is zero: all but the outline.
    Interior,
    /// The head pixels where both components of the gradient of the mask are positive, as printed: only the parts of the
    /// outline that face up and left.
    Literal,
}

/// Padding of the Sobel operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Border {
    /// The nearest pixel, so that a constant image has zero gradients everywhere.
    Replicate,
    /// Zeros, as in a padded convolution.
    Zero,
}

/// A loss between predicted and true flow: an entry of [`SEQUENCE_LOSSES`](super::SEQUENCE_LOSSES).
pub struct SequenceLoss {
    /// Value of `loss.sequence` in a configuration.
    pub name: &'static str,
    /// One line, for documentation and reports.
    pub description: &'static str,
    pub(super) distance: Distance,
    /// Channels of the distance.
    pub(super) channels: usize,
}

/// Computes the error at each pixel, `[batch, channels, height, width]`, from the difference of prediction and truth,
/// `[batch, 2, height, width]`.
pub(super) enum Distance {
    /// Averaged over all pixels; those that do not count contribute 0.
    OfFlow(fn(Tensor<4>) -> Tensor<4>),
    /// Also takes the predicted mixture and the limits of its log scales. Averaged over the pixels that count.
    OfMixture(fn(Tensor<4>, &LaplaceMixture, [f64; 2]) -> Tensor<4>),
}

impl SequenceLoss {
    /// Whether the network must also predict a [`LaplaceMixture`].
    pub fn needs_mixture(&self) -> bool {
        matches!(self.distance, Distance::OfMixture(_))
    }
}

/// One of the paper's regularizers: an entry of [`REGULARIZERS`](super::REGULARIZERS).
pub struct Regularizer {
    /// Key of its weight in the section `loss` of a configuration, and name in logs and results.
    pub name: &'static str,
    /// The paper's abbreviation.
    pub title: &'static str,
    /// The paper's `lambda_N`; 1 for MIGAR and IGVAR, which have none.
    pub paper_weight: f64,
    /// One line, for documentation and reports.
    pub description: &'static str,
    pub(super) value: RegularizerValue,
}

/// Computes the value of a regularizer for one prediction, `[batch, 2, height, width]`. The foreground is `M_bg`,
/// `[batch, 1, height, width]`.
pub(super) enum RegularizerValue {
    /// From flow and foreground.
    OfFlow(fn(Tensor<4>, &Tensor<4>, Border) -> Tensor<1>),
    /// The variation of the flow inside `M_total`, each pixel weighted by `base^-G`. The function computes the logarithm of the
    /// base, `[batch, 1, 1, 1]`, from `G`, `[batch, 1, height, width]`, and the foreground.
    WeightedVariation { log_base: fn(Tensor<4>, &Tensor<4>) -> Tensor<4> },
}

impl Regularizer {
    /// Whether it depends on `M_total`, whose formula in the paper has two [readings](MaskReading).
    pub fn reads_total_mask(&self) -> bool {
        matches!(self.value, RegularizerValue::WeightedVariation { .. })
    }
}

/// Compares and prints entries by name.
macro_rules! by_name {
    ($($entry:ty),*) => {$(
        impl PartialEq for $entry {
            fn eq(&self, other: &Self) -> bool {
                self.name == other.name
            }
        }

        impl fmt::Debug for $entry {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name)
            }
        }
    )*};
}

by_name!(SequenceLoss, Regularizer);
