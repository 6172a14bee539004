//! Clips with their features, which classifiers learn from.

use crate::features::Features;
use crate::head_motion::SubtractedMotion;

/// One clip with its features. (dataset, subject, clip) identifies it: clip names repeat across subjects.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The dataset's kind, e.g. `casme2`.
    pub dataset: String,
    /// The subject, spelled as in the dataset, e.g. `006`.
    pub subject: String,
    /// The clip's name, e.g. `006_1_2`.
    pub clip: String,
    /// Class number.
    pub class: usize,
    pub features: Features,
    /// The motion of the head that was subtracted, if any was.
    pub head_motion: Option<SubtractedMotion>,
}
