//! The configuration of a training run: one TOML file; each key can be overridden on the command line.

mod augmentation;
mod check;
mod read;
mod text;

use std::collections::BTreeMap;
use std::path::PathBuf;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use srflow_field::Size;
use srflow_nets::{Architecture, Network};

use crate::loss::LossConfig;
pub use augmentation::{AugmentationConfig, AugmentationKind};
pub use read::{ConfigError, PRESETS, Preset};
pub use text::Source;

/// A training run. The default is the paper's retrained SKFlow (section V-A1); what the paper leaves open is SKFlow's.
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
    /// What batch norm does.
    pub batch_norm: BatchNorm,
    /// Settings of the network, by name; the others are its own.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub settings: BTreeMap<String, usize>,
}

/// Where the statistics of batch norm come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BatchNorm {
    /// Frozen when training starts from weights, as the authors of RAFT fine-tune; live from random ones.
    Auto,
    /// From the batch, and the running ones follow. For training from random weights.
    Live,
    /// The running ones, unchanged. For fine-tuning, and for batches too small for statistics.
    Frozen,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Datasets: `KIND:DIR`, `@SPLIT` for another split than `train`, `*TIMES` for a pair to come several times in an
    /// epoch.
    #[serde(with = "text::by_texts")]
    pub train: Vec<Source>,
    /// Size of the crops, WIDTHxHEIGHT.
    #[serde(with = "text::by_text")]
    pub crop: Size,
    /// Threads that read and augment pairs.
    pub workers: usize,
    /// Pairs that are read ahead.
    pub prefetch: usize,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingConfig {
    /// Seed of every random choice.
    pub seed: u64,
    /// Times that every pair is used; what does not fill a batch at the end of an epoch is left out.
    pub epochs: u64,
    /// Steps, whatever the epochs; 0 for as many as the epochs take.
    pub steps: u64,
    /// Pairs in a step.
    pub batch: usize,
    /// Parts that a batch is cut into, one after the other through the network, to save memory.
    pub accumulate: usize,
    /// Refinements of the network.
    pub iterations: usize,
    /// Keep only the hidden state of each refinement and compute the rest again on the way back: less memory, more time,
    /// the same gradients.
    pub recompute: bool,
    /// The greatest learning rate of the cycle.
    pub learning_rate: f64,
    /// Share of the cycle in which the learning rate rises.
    pub rising: f64,
    /// Steps that the cycle is longer than the training.
    pub extra_steps: u64,
    /// AdamW's weight decay.
    pub weight_decay: f64,
    /// AdamW's epsilon.
    pub epsilon: f64,
    /// AdamW's decay rates.
    pub betas: [f64; 2],
    /// The greatest norm of all gradients together; longer ones are scaled down.
    pub clip: f64,
    /// Steps with a loss that is not finite, one after the other, that end the run. Each is skipped.
    pub bad_steps: u64,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationConfig {
    /// Datasets, as in `data.train`; the usual split is `val`. Without any, those of `data.train` that have one. The
    /// first decides which checkpoint is the best.
    #[serde(with = "text::by_texts")]
    pub data: Vec<Source>,
    /// Steps between two validations; 0 for one at the end of each epoch.
    pub every: u64,
    /// Refinements; 0 for as many as in training.
    pub iterations: usize,
    /// Size of the window around the head that is scored, WIDTHxHEIGHT; empty for whole frames.
    #[serde(with = "text::optional_size")]
    pub crop: Option<Size>,
    /// Score only so many pairs of each dataset, spread evenly; 0 for all.
    pub limit: usize,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Steps between two checkpoints; 0 for one at the end of each epoch. The last step has one in any case.
    pub every: u64,
    /// How many of the last ones are kept, beside the best.
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
    /// The network with random parameters.
    pub(crate) fn init(&self, device: &Device) -> Network {
        self.with_settings(self.architecture.init(device))
    }

    /// Panics where the settings were not [checked](Config::check).
    pub(crate) fn with_settings(&self, mut network: Network) -> Network {
        for (name, value) in &self.settings {
            network.set(name, *value).expect("settings that were checked");
        }
        network
    }

    /// Whether batch norm takes its statistics from the batches.
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
        Self { train: Vec::new(), crop: Size { width: 512, height: 800 }, workers: 2, prefetch: 16 }
    }
}

impl Default for TrainingConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            epochs: 45,
            steps: 0,
            batch: 8,
            accumulate: 1,
            iterations: 12,
            recompute: false,
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

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { every: 0, keep: 3 }
    }
}
