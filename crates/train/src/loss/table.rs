//! What the tables of losses hold. Configuration, ablation, log, `srflow metrics --regularizers` and `docs/losses.md` read
//! them. A regularizer is a file of this folder with a `REGULARIZER`, and its name in the list in `config.rs`.

use std::fmt;

use burn::tensor::Tensor;
use srflow_nets::LaplaceMixture;

use super::{Border, sequence};

/// How a predicted flow is compared with the truth: an entry of [`SEQUENCE_LOSSES`].
pub struct SequenceLoss {
    /// Value of `loss.sequence` in a configuration.
    pub name: &'static str,
    /// One line on what it is.
    pub description: &'static str,
    pub(super) distance: Distance,
    /// Channels of the distance.
    pub(super) channels: usize,
}

/// The distance of a prediction from the truth at each pixel, `[batch, channels, height, width]`, from their difference,
/// `[batch, 2, height, width]`.
pub(super) enum Distance {
    /// Averaged over all pixels, those that do not count as 0.
    OfFlow(fn(Tensor<4>) -> Tensor<4>),
    /// From the mixture that the network predicts too, and the limits of its log scales. Averaged over the pixels that
    /// count.
    OfMixture(fn(Tensor<4>, &LaplaceMixture, [f64; 2]) -> Tensor<4>),
}

/// Every sequence loss, the default first.
pub static SEQUENCE_LOSSES: &[SequenceLoss] =
    &[sequence::L1, sequence::L2, super::mixture::MIXTURE_OF_LAPLACE];

impl SequenceLoss {
    /// Whether the network must predict a [`LaplaceMixture`] beside the flow.
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
    /// `lambda_N` of TVR and FDR, none (1) of MIGAR and IGVAR.
    pub paper_weight: f64,
    /// One line on what it is.
    pub description: &'static str,
    pub(super) value: RegularizerValue,
}

/// The value of a regularizer for one prediction, `[batch, 2, height, width]`. The foreground is `M_bg`,
/// `[batch, 1, height, width]`.
pub(super) enum RegularizerValue {
    /// From flow and foreground.
    OfFlow(fn(Tensor<4>, &Tensor<4>, Border) -> Tensor<1>),
    /// The variation of the flow inside `M_total` with the weight `base^-G` of each pixel. The function gives the logarithm
    /// of the base, `[batch, 1, 1, 1]`, from `G`, `[batch, 1, height, width]`, and the foreground.
    WeightedVariation { log_base: fn(Tensor<4>, &Tensor<4>) -> Tensor<4> },
}

impl Regularizer {
    /// Whether it looks at the pixels of `M_total`, which the paper leaves two readings of.
    pub fn reads_total_mask(&self) -> bool {
        matches!(self.value, RegularizerValue::WeightedVariation { .. })
    }
}

/// Entries are known by their names.
macro_rules! known_by_name {
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

known_by_name!(SequenceLoss, Regularizer);
