//! Scoring a network while it is trained.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use srflow_data::read::{DatasetError, FlowDataset, Split};
use srflow_eval::{Evaluation, OnFailure, Settings, evaluate};
use srflow_field::{EstimateError, FlowEstimator, FlowField, Image};
use srflow_nets::{Frames, Network, Request, load_network};

use crate::config::{Config, Source};
use crate::journal::ValidationRecord;
use crate::parameters::numbers;
use crate::run::TrainError;

/// The datasets that are scored.
pub(crate) struct Validation {
    datasets: Vec<FlowDataset>,
    settings: Settings,
    iterations: usize,
}

/// Why a network could not be scored.
#[derive(Debug, thiserror::Error)]
pub enum ValidationError {
    /// A dataset could not be listed.
    #[error("validation: {0}")]
    Dataset(#[from] DatasetError),
    /// A pair could not be scored.
    #[error("validation: {0}")]
    Evaluate(#[from] srflow_eval::EvaluateError),
    /// No pair of the dataset had a pixel to score.
    #[error("validation: {dataset}: no pixel of any pair has a known flow")]
    NoPixel {
        /// The dataset and its split.
        dataset: String,
    },
}

impl Validation {
    /// Lists the datasets of `validation.data`, else those of `data.train` that have a split `val`.
    pub(crate) fn open(config: &Config) -> Result<Self, ValidationError> {
        let datasets = if config.validation.data.is_empty() {
            config
                .data
                .train
                .iter()
                .filter_map(|source| val_split(source).transpose())
                .collect::<Result<_, _>>()?
        } else {
            config.validation.data.iter().map(open).collect::<Result<_, _>>()?
        };
        let crop = config.validation.crop.map(|crop| (crop.width, crop.height));
        let limit = (config.validation.limit > 0).then_some(config.validation.limit);
        let iterations = match config.validation.iterations {
            0 => config.training.iterations,
            iterations => iterations,
        };
        let settings = Settings { crop, limit, on_failure: OnFailure::Stop };
        Ok(Self { datasets, settings, iterations })
    }

    /// Whether there is nothing to score.
    pub(crate) fn is_empty(&self) -> bool {
        self.datasets.is_empty()
    }

    /// Scores `network`, a plain one without automatic differentiation.
    pub(crate) fn score(
        &self,
        network: Network,
        device: &Device,
    ) -> Result<Vec<ValidationRecord>, ValidationError> {
        let network = InTraining { network, device: device.clone(), iterations: self.iterations };
        self.datasets
            .iter()
            .map(|dataset| {
                let evaluation = evaluate(dataset, &[&network], self.settings, &mut |_| {})?;
                scores(evaluation)
            })
            .collect()
    }
}

/// The scores of a finished run's last weights on `dataset`, as `config` validates.
pub(crate) fn score_weights(
    config: &Config,
    device: &Device,
    run: &Path,
    dataset: &FlowDataset,
) -> Result<ValidationRecord, TrainError> {
    let validation = Validation { datasets: vec![dataset.clone()], ..Validation::open(config)? };
    let network = load_network(config.network.architecture, &run.join("last.safetensors"), device)?;
    let scores = validation.score(network, device)?;
    Ok(scores.into_iter().next().expect("one dataset was scored"))
}

/// The split asked for, else `val`, else all pairs of a dataset that knows no splits.
fn open(source: &Source) -> Result<FlowDataset, DatasetError> {
    let wanted = source.split.unwrap_or(Split::Val);
    FlowDataset::open(&source.spec, Some(wanted)).or_else(|error| {
        let whole = FlowDataset::open(&source.spec, None).ok();
        whole.filter(|whole| source.split.is_none() && whole.split() == Split::All).ok_or(error)
    })
}

/// The split `val` of a training dataset, if it has one.
fn val_split(source: &Source) -> Result<Option<FlowDataset>, DatasetError> {
    match FlowDataset::open(&source.spec, Some(Split::Val)) {
        Ok(dataset) => Ok(Some(dataset)),
        Err(DatasetError::NoSplit { .. } | DatasetError::NotThere { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// As after step 0.
fn scores(evaluation: Evaluation) -> Result<ValidationRecord, ValidationError> {
    // The baseline comes first.
    let [zero, network] = &evaluation.methods[..] else { unreachable!("two methods were scored") };
    match (&zero.whole, &network.whole) {
        (Some(zero), Some(whole)) => Ok(ValidationRecord {
            step: 0,
            pairs: evaluation.pairs,
            whole: *whole,
            head: network.head,
            zero_epe: zero.epe,
            dataset: evaluation.dataset,
        }),
        _ => Err(ValidationError::NoPixel { dataset: evaluation.dataset }),
    }
}

struct InTraining {
    network: Network,
    device: Device,
    iterations: usize,
}

impl FlowEstimator for InTraining {
    fn name(&self) -> &str {
        "the network in training"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        let (first, second) = (frame1.size(), frame2.size());
        if first != second {
            return Err(EstimateError::SizeMismatch { first, second });
        }
        let (width, height) = first;
        let tensor = |frame: &Image| {
            let planes = (0..3).flat_map(|channel| {
                frame.pixels().iter().map(move |pixel| f32::from(pixel[channel]) / 255.0)
            });
            let data = TensorData::new(planes.collect::<Vec<f32>>(), [1, 3, height, width]);
            Tensor::<4>::from_data(data, &self.device)
        };
        let frames = Frames { first: tensor(frame1), second: tensor(frame2) };
        let estimate = self.network.forward(frames, &Request::new(self.iterations));
        let planes = numbers(estimate.last().clone());
        let (u, v) = planes.split_at(width * height);
        let flow = u.iter().zip(v).map(|(&u, &v)| [u, v]).collect();
        FlowField::from_pixels(width, height, flow).map_err(|error| EstimateError::Unsupported {
            method: self.name().to_owned(),
            reason: error.to_string(),
        })
    }
}
