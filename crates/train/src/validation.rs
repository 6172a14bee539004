//! Scores a network during training.

use std::num::NonZeroUsize;

use burn::tensor::Device;
use srflow_data::flow::{DatasetError, FlowDataset, Split};
use srflow_eval::{Evaluation, Method, Settings, evaluate};
use srflow_nets::{Network, NetworkEstimator};

use crate::config::{Config, Source};
use crate::training_log::ValidationRecord;
use crate::training_set::open_dataset;

/// The validation datasets and settings of a run.
pub(crate) struct Validation {
    datasets: Vec<FlowDataset>,
    settings: Settings<'static>,
    iterations: NonZeroUsize,
}

#[derive(Debug, thiserror::Error)]
pub enum ValidationError {
    #[error("validation: {0}")]
    Dataset(#[from] DatasetError),
    #[error("validation: {0}")]
    Evaluate(#[from] srflow_eval::EvaluateError),
    #[error("validation: {dataset}: no pixel of any pair has a known flow")]
    NoPixel { dataset: String },
}

impl Validation {
    /// Without datasets.
    pub(crate) fn none(config: &Config) -> Self {
        Self::of(config, Vec::new())
    }

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
            config
                .validation
                .data
                .iter()
                .filter_map(|source| Some(open_dataset(source.files()?, source.split, Split::Val)))
                .collect::<Result<_, _>>()?
        };
        Ok(Self::of(config, datasets))
    }

    pub(crate) fn of(config: &Config, datasets: Vec<FlowDataset>) -> Self {
        let limit = (config.validation.limit > 0).then_some(config.validation.limit);
        // A checked configuration trains with at least one iteration.
        let iterations = [config.validation.iterations, config.training.iterations];
        let iterations = iterations.into_iter().find_map(NonZeroUsize::new).unwrap_or(NonZeroUsize::MIN);
        let settings = Settings { crop: config.validation.crop, limit, ..Settings::default() };
        Self { datasets, settings, iterations }
    }

    /// One line per dataset: name, split and number of pairs.
    pub(crate) fn describe(&self) -> Vec<String> {
        let words = |dataset: &FlowDataset| {
            format!("{} ({}): {} pairs", dataset.name(), dataset.split(), dataset.entries().len())
        };
        self.datasets.iter().map(words).collect()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.datasets.is_empty()
    }

    /// Scores `network`, which must not track gradients, on each dataset.
    pub(crate) fn score(
        &self,
        network: Network,
        device: &Device,
    ) -> Result<Vec<ValidationRecord>, ValidationError> {
        let name = "the network in training";
        let network = NetworkEstimator::new(name, network, self.iterations, device.clone());
        self.datasets
            .iter()
            .map(|dataset| {
                let evaluation =
                    evaluate(dataset, &[Method::Estimator(&network)], self.settings, &mut |_| {})?;
                scores(evaluation)
            })
            .collect()
    }
}

/// The split `val` of a training dataset, if it has one.
fn val_split(source: &Source) -> Result<Option<FlowDataset>, DatasetError> {
    let Some(spec) = source.files() else { return Ok(None) };
    match FlowDataset::open(spec, Some(Split::Val)) {
        Ok(dataset) => Ok(Some(dataset)),
        Err(DatasetError::NoSplit { .. } | DatasetError::NotThere { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The record of an evaluation, with step 0.
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
            dataset: evaluation.title(),
        }),
        _ => Err(ValidationError::NoPixel { dataset: evaluation.title() }),
    }
}
