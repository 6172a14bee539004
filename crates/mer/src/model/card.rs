//! What is known about a model: how clips become its input, what it learned from, and how right it is.

use serde::{Deserialize, Serialize};

use crate::classifier::ClassifierEntry;
use crate::extract::FeatureSettings;

/// What is known about a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelCard {
    /// Of srflow, which trained it.
    pub srflow_version: String,
    /// When it was trained, UTC.
    pub date: String,
    /// What a user should know first.
    pub note: String,
    pub classifier: ClassifierEntry,
    /// The classes' names, by number.
    pub classes: Vec<String>,
    /// How flow becomes features.
    pub features: FeatureSettings,
    /// How faces were cut out.
    pub faces: String,
    pub flow: ModelFlow,
    /// What it was trained on.
    pub data: Vec<ModelData>,
    /// How right it is about subjects that it was not trained on.
    pub held_out: HeldOut,
    /// Scores are divided by it before they become probabilities.
    pub temperature: f64,
    pub range: TrainingRange,
}

/// The flow method of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFlow {
    /// As it was given, such as `srflow` or `skflow=best.safetensors`.
    pub method: String,
    /// SHA-256 of a network's weights, in hexadecimal digits.
    pub sha256: Option<String>,
    /// Parameters and their values, as text.
    pub parameters: String,
}

/// A dataset that a model was trained on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelData {
    pub dataset: String,
    pub clips: usize,
    pub subjects: usize,
}

/// Predictions about clips of subjects that were left out of training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOut {
    pub clips: usize,
    /// Clips whose class is right.
    pub right: usize,
    /// Clips whose probability is at least a half, and those of them whose class is right.
    pub sure: usize,
    pub sure_and_right: usize,
}

/// Extremes of the training clips.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingRange {
    /// Root mean square of the flow, in pixels of the feature map.
    pub motion_px: [f64; 2],
    /// Width of the faces, in pixels.
    pub face_px: [usize; 2],
    /// The part of a clip's motion that the model's patterns leave unexplained, at most.
    pub unexplained: f64,
}
