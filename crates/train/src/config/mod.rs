//! The configuration of a training run: a TOML file, each key of which can be overridden on the command line.

mod augmentation;
mod check;
mod error;
mod made;
mod read;
mod text;

use std::collections::BTreeMap;
use std::path::PathBuf;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use srflow_core::Size;
use srflow_nets::{Architecture, Network, load_to_train};
use srflow_nn::{Layout, WeightsError};
use srflow_ops::Precision;

use crate::loss::LossConfig;
pub use crate::starts::Starts;
pub use augmentation::{AugmentationConfig, AugmentationKind};
pub use error::ConfigError;
pub use made::{RenderedConfig, ShapesConfig};
pub use read::PRESETS;
pub use text::{DataSpec, MadeKind, MadeSpec, Source};

/// Configuration of a training run. The default is the paper's retrained SKFlow (section V-A1), with SKFlow's own settings where
/// the paper gives none.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    pub network: NetworkConfig,
    pub data: DataConfig,
    pub augmentation: AugmentationConfig,
    pub training: TrainingConfig,
    pub loss: LossConfig,
    pub validation: ValidationConfig,
    pub checkpoints: CheckpointConfig,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// Name of the network, e.g. `skflow`.
    #[serde(with = "text::architecture")]
    pub architecture: Architecture,
    /// Weights to start from, PyTorch or safetensors; empty for random ones.
    pub weights: PathBuf,
    pub batch_norm: BatchNorm,
    /// Settings of the network by name; those left out keep their defaults.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, usize>,
}

/// Source of the statistics of batch norm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BatchNorm {
    /// `Frozen` when training starts from weights, as RAFT's authors do for fine-tuning; otherwise `Live`.
    Auto,
    /// Use the statistics of the batch and update the running ones. For training from random weights.
    Live,
    /// Use the running statistics and leave them unchanged. For fine-tuning, and for batches too small for statistics.
    Frozen,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Datasets: `KIND:DIR`, then `@SPLIT` for a split other than `train`, then `*TIMES` to repeat each pair that often in an
    /// epoch. `shapes:` or `shapes:TEXTURES_DIR`, and `rendered:` or `rendered:HEAD`, are made while training.
    #[serde(with = "text::by_texts")]
    pub train: Vec<Source>,
    /// Size of the crops, WIDTHxHEIGHT.
    #[serde(with = "text::by_text")]
    pub crop: Size,
    /// Threads that read, make and augment pairs.
    pub workers: usize,
    /// Most pairs that are prefetched.
    pub prefetch: usize,
    pub shapes: ShapesConfig,
    pub rendered: RenderedConfig,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingConfig {
    /// Seed of every random choice.
    pub seed: u64,
    /// Passes over the data; an incomplete last batch of an epoch is dropped.
    pub epochs: u64,
    /// Training steps, overriding `epochs`; 0 to train for `epochs`.
    pub steps: u64,
    /// Samples per step.
    pub batch: usize,
    /// Frames of a sample: 2 for a pair; more for clips, only for networks that remember earlier pairs of a video.
    pub clip_frames: usize,
    /// Parts that a batch is split into, processed one after another to save memory.
    pub accumulate: usize,
    /// Refinement iterations of the network.
    pub iterations: usize,
    /// What the network starts from: `own`, or `varied` flows, good and bad ones.
    pub starts: Starts,
    /// Store only the hidden state of each iteration and recompute the rest in the backward pass: less memory, more time, the
    /// same gradients.
    pub recompute: bool,
    /// What networks multiply, forward and backward: `f32`, `bf16` on the CPU, or what the device has of `f16` and `bf16`. Sums, weights,
    /// loss and norms are `f32`.
    #[serde(with = "text::precision")]
    pub precision: Precision,
    /// The peak learning rate of the one-cycle schedule.
    pub learning_rate: f64,
    /// Share of the cycle in which the learning rate rises.
    pub rising: f64,
    /// Steps by which the cycle is longer than the training.
    pub extra_steps: u64,
    /// AdamW's weight decay.
    pub weight_decay: f64,
    /// AdamW's epsilon.
    pub epsilon: f64,
    /// AdamW's betas: decay rates of its averages.
    pub betas: [f64; 2],
    /// Largest norm of all gradients; larger ones are scaled down to it.
    pub clip: f64,
    /// Consecutive steps with a non-finite loss or gradient after which the run ends; fewer are skipped.
    pub bad_steps: u64,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationConfig {
    /// Datasets, as in `data.train`, with the default split `val`. If empty, the `val` splits of `data.train`. The first decides
    /// which checkpoint is the best.
    #[serde(with = "text::by_texts")]
    pub data: Vec<Source>,
    /// Steps between two validations; 0 for one after each epoch.
    pub every: u64,
    /// Refinement iterations of the network; 0 for as many as in training.
    pub iterations: usize,
    /// Size of the scored window around the head, WIDTHxHEIGHT; empty for whole frames.
    #[serde(with = "text::optional_size")]
    pub crop: Option<Size>,
    /// Score only this many pairs of each dataset, spread evenly; 0 for all.
    pub limit: usize,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Steps between two checkpoints; 0 for one after each epoch. The last step always has one.
    pub every: u64,
    /// Number of latest checkpoints to keep, in addition to the best.
    pub keep: usize,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            architecture: Architecture::SkFlow,
            weights: PathBuf::new(),
            batch_norm: BatchNorm::Auto,
            settings: BTreeMap::new(),
        }
    }
}

impl NetworkConfig {
    /// A network with these settings and random parameters.
    pub(crate) fn init(&self, device: &Device) -> Network {
        self.with_settings(self.architecture.init(device))
    }

    /// Loads the initial weights, if there are any, in the order of their [`Layout`]. Adds settings in their file that the
    /// configuration does not set.
    pub(crate) fn load_weights(&mut self, device: &Device) -> Result<Option<Vec<f32>>, WeightsError> {
        if self.weights.as_os_str().is_empty() {
            return Ok(None);
        }
        let mut network = load_to_train(self.architecture, &self.weights, device)?;
        let mut random = self.architecture.init(device);
        for (of_file, default) in network.settings().into_iter().zip(random.settings()) {
            if of_file.value != default.value {
                self.settings.entry(of_file.name.to_owned()).or_insert(*of_file.value);
            }
        }
        Ok(Some(Layout::of(&network).1))
    }

    /// `network` with these settings. Panics when they are invalid; see [`Config::check`].
    pub(crate) fn with_settings(&self, mut network: Network) -> Network {
        for (name, value) in &self.settings {
            network.set(name, *value).expect("checked settings");
        }
        network
    }

    /// Whether batch norm uses the statistics of the batch.
    pub fn has_live_batch_norm(&self) -> bool {
        match self.batch_norm {
            BatchNorm::Auto => self.weights.as_os_str().is_empty(),
            BatchNorm::Live => true,
            BatchNorm::Frozen => false,
        }
    }
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            train: Vec::new(),
            crop: Size::new(512, 800),
            workers: 2,
            prefetch: 16,
            shapes: ShapesConfig::default(),
            rendered: RenderedConfig::default(),
        }
    }
}

impl DataConfig {
    /// Size of the frames of `shapes:`.
    pub fn shapes_size(&self) -> Size {
        self.shapes.size.unwrap_or_else(|| with_margin(self.crop))
    }

    /// Size of the frames of `rendered:`: without one, the proportions of the paper's frames, 2200x3208.
    pub fn rendered_size(&self) -> Size {
        self.rendered.size.unwrap_or_else(|| {
            let Size { width, height } = with_margin(self.crop);
            let of_height = height.saturating_mul(2200).div_ceil(3208);
            let of_width = width.saturating_mul(3208).div_ceil(2200);
            Size { width: width.max(of_height), height: height.max(of_width) }
        })
    }
}

/// The crop and an eighth more along each side, for augmentation; a multiple of 8.
fn with_margin(Size { width, height }: Size) -> Size {
    let wider = |side: usize| side.saturating_add(side / 8).saturating_add(7) / 8 * 8;
    Size { width: wider(width), height: wider(height) }
}

impl Default for TrainingConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            epochs: 45,
            steps: 0,
            batch: 8,
            clip_frames: 2,
            accumulate: 1,
            iterations: 12,
            starts: Starts::Own,
            recompute: false,
            precision: Precision::F32,
            learning_rate: 1.25e-4,
            rising: 0.05,
            extra_steps: 100,
            weight_decay: 1e-4,
            epsilon: 1e-8,
            betas: [0.9, 0.999],
            clip: 1.0,
            bad_steps: 10,
        }
    }
}

impl TrainingConfig {
    /// Pairs of a sample.
    pub(crate) fn pairs(&self) -> usize {
        self.clip_frames.max(2) - 1
    }
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { every: 0, keep: 3 }
    }
}
