//! The training samples: pairs, or clips of consecutive pairs, of a mix of datasets, reshuffled every epoch and augmented.
//!
//! The sample at a place of a batch and its augmentation depend only on the seed, the step and the place, so any sample can be
//! made on any thread, in any order.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use srflow_field::Size;
use srflow_field::random::Key;
use srflow_read::augment::{AugmentError, Augmentation};
use srflow_read::flow::{DatasetError, Entry, FlowDataset, Sample, Split};

use crate::config::{Config, Source};

/// Errors in the training data.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    #[error(
        "data.train is empty: choose a dataset to train on, e.g. --data srflow:DIR, or --data folder:DIR for a plain folder \
         of pairs"
    )]
    NoData,
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(
        "{dataset} in {}: none of its {pairs} pairs has a true flow to learn from; {advice}", .dir.display()
    )]
    NoTruth { dataset: String, dir: PathBuf, pairs: usize, advice: &'static str },
    #[error(
        "{dataset} in {}: no {frames} consecutive frames with a true flow for each pair (training.clip_frames); choose a \
         dataset of videos, or set training.clip_frames=2 to train on pairs", .dir.display()
    )]
    NoClip { dataset: String, dir: PathBuf, frames: usize },
    #[error(
        "{pair}: its frames are {}x{}, less than half the crop of {crop} (WIDTHxHEIGHT); set data.crop (--crop) to at most \
         the size of the frames",
        .frame.0, .frame.1
    )]
    TooSmall {
        pair: String,
        /// Width and height.
        frame: (usize, usize),
        crop: Size,
    },
    #[error("{0}")]
    Settings(AugmentError),
    #[error("{pair}: {source}")]
    Augment { pair: String, source: AugmentError },
}

const NO_TRUTH_ADVICE: &str = "choose a split whose truth is published, or for a plain folder put a flow beside each pair \
                               (docs/training.md)";

/// The training samples of all datasets.
pub struct TrainingSet {
    parts: Vec<Part>,
    /// Pairs of a sample.
    pairs: usize,
    crop: Size,
    seed: u64,
    /// Shuffled orders of the epochs in use.
    orders: Mutex<BTreeMap<u64, Arc<[usize]>>>,
}

/// One dataset of the mix.
struct Part {
    dataset: FlowDataset,
    /// Indices of the first pairs of samples all of whose pairs have a true flow.
    first_pairs: Vec<usize>,
    times: usize,
    augmentation: Augmentation,
}

/// An augmented and cropped pair.
#[derive(Debug, Clone)]
pub struct TrainingSample {
    /// File of the first frame, which identifies the pair.
    pub name: String,
    pub sample: Sample,
}

impl TrainingSet {
    /// Lists the samples of every dataset of `data.train`.
    ///
    /// # Errors
    /// When `data.train` is empty, a dataset cannot be listed, none of its pairs has a true flow, or it has no clips as long as
    /// the configuration says.
    pub fn open(config: &Config) -> Result<Self, DataError> {
        if config.data.train.is_empty() {
            return Err(DataError::NoData);
        }
        let parts = config.data.train.iter().map(|source| Part::open(source, config));
        Ok(Self {
            parts: parts.collect::<Result<_, _>>()?,
            pairs: config.training.pairs(),
            crop: config.data.crop,
            seed: config.training.seed,
            orders: Mutex::default(),
        })
    }

    /// Samples in an epoch, repeated ones counted as often as they occur.
    pub fn samples(&self) -> usize {
        self.parts.iter().map(Part::samples).sum()
    }

    /// Steps in an epoch, at least one. An incomplete last batch is dropped; a set smaller than one batch is repeated to fill it.
    pub fn steps_per_epoch(&self, batch: usize) -> u64 {
        (self.samples() / batch).max(1) as u64
    }

    /// One line per dataset: name, split and number of pairs or clips.
    pub fn describe(&self) -> Vec<String> {
        let words = |part: &Part| {
            let times = if part.times == 1 { String::new() } else { format!(", {} times each", part.times) };
            let dataset = &part.dataset;
            let of_frames = match self.pairs {
                1 => "pairs".to_owned(),
                pairs => format!("clips of {} frames", pairs + 1),
            };
            let count = part.first_pairs.len();
            format!("{} ({}): {count} {of_frames}{times}", dataset.name(), dataset.split())
        };
        self.parts.iter().map(words).collect()
    }

    /// The pairs of the sample at `place`, from 0, of the batch of `step`, from 0, all with the same augmentation.
    ///
    /// # Errors
    /// When its files cannot be read, or its frames are smaller than half the crop.
    pub fn sample(&self, step: u64, place: usize, batch: usize) -> Result<Vec<TrainingSample>, DataError> {
        let steps = self.steps_per_epoch(batch);
        let order = self.order(step / steps);
        let position = (step % steps) as usize * batch + place;
        let (part, first) = self.first_pair(order[position % order.len()]);
        let key = Key::new(self.seed).scene(step as u32).frame(place as u32);
        let entries = &part.dataset.entries()[first..first + self.pairs];
        entries.iter().map(|entry| self.pair(part, entry, key)).collect()
    }

    fn pair(&self, part: &Part, entry: &Entry, key: Key) -> Result<TrainingSample, DataError> {
        let name = entry.frame1.display().to_string();
        let sample = part.dataset.read(entry)?;
        let frame @ (width, height) = sample.frame1.size();
        if 2 * width < self.crop.width || 2 * height < self.crop.height {
            return Err(DataError::TooSmall { pair: name, frame, crop: self.crop });
        }
        match part.augmentation.apply(sample, key) {
            Ok(sample) => Ok(TrainingSample { name, sample }),
            Err(source) => Err(DataError::Augment { pair: name, source }),
        }
    }

    /// Numbers of the samples of an epoch, shuffled.
    fn order(&self, epoch: u64) -> Arc<[usize]> {
        let mut orders = self.orders.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(order) = orders.get(&epoch) {
            return order.clone();
        }
        let order = shuffled(self.samples(), Key::new(self.seed).scene(epoch as u32));
        orders.insert(epoch, order.clone());
        // Prefetching never reaches further than the next epoch.
        orders.retain(|&other, _| other.abs_diff(epoch) <= 1);
        order
    }

    fn first_pair(&self, mut number: usize) -> (&Part, usize) {
        let mut parts = self.parts.iter();
        loop {
            let part = parts.next().expect("a number below the samples of all parts");
            if number < part.samples() {
                return (part, part.first_pairs[number % part.first_pairs.len()]);
            }
            number -= part.samples();
        }
    }
}

impl Part {
    fn open(source: &Source, config: &Config) -> Result<Self, DataError> {
        let dataset = open_dataset(source, Split::Train)?;
        let entries = dataset.entries();
        let title = || format!("{} ({})", dataset.name(), dataset.split());
        if entries.iter().all(|entry| entry.flow.is_none()) {
            return Err(DataError::NoTruth {
                dataset: title(),
                dir: dataset.dir().to_owned(),
                pairs: entries.len(),
                advice: NO_TRUTH_ADVICE,
            });
        }
        let clips = entries.windows(config.training.pairs()).enumerate();
        let first_pairs: Vec<usize> =
            clips.filter(|(_, pairs)| is_clip(pairs)).map(|(first, _)| first).collect();
        if first_pairs.is_empty() {
            let frames = config.training.clip_frames;
            return Err(DataError::NoClip { dataset: title(), dir: dataset.dir().to_owned(), frames });
        }
        let settings = config.augmentation.settings(dataset.density(), config.data.crop);
        let augmentation = Augmentation::new(settings).map_err(DataError::Settings)?;
        Ok(Self { dataset, first_pairs, times: source.times, augmentation })
    }

    fn samples(&self) -> usize {
        self.first_pairs.len() * self.times
    }
}

/// Whether all pairs have a true flow and each continues the one before.
fn is_clip(pairs: &[Entry]) -> bool {
    pairs.iter().all(|pair| pair.flow.is_some())
        && pairs.windows(2).all(|two| two[0].frame2 == two[1].frame1 && two[0].scene == two[1].scene)
}

/// Opens the split of `source`, by default the split `usual`, or all pairs of a dataset without splits.
pub(crate) fn open_dataset(source: &Source, usual: Split) -> Result<FlowDataset, DatasetError> {
    if source.split.is_some() {
        return FlowDataset::open(&source.spec, source.split);
    }
    let error = match FlowDataset::open(&source.spec, Some(usual)) {
        Ok(dataset) => return Ok(dataset),
        Err(error) => error,
    };
    match FlowDataset::open(&source.spec, None) {
        Ok(dataset) if dataset.split() == Split::All => Ok(dataset),
        // A plain folder need not have subfolders for splits, so the error about the folder itself is the useful one.
        Err(plain) if source.spec.kind == "folder" && !source.spec.dir.join(usual.to_string()).is_dir() => {
            Err(plain)
        }
        _ => Err(error),
    }
}

/// `0..count` in a random order.
fn shuffled(count: usize, key: Key) -> Arc<[usize]> {
    let mut order: Vec<usize> = (0..count).collect();
    key.stream("training order").shuffle(&mut order);
    order.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_contains_every_pair_once_and_differs_between_epochs() {
        let orders: Vec<_> = (0..3).map(|epoch| shuffled(100, Key::new(7).scene(epoch))).collect();
        for order in &orders {
            let mut sorted = order.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..100).collect::<Vec<_>>());
        }
        assert!(orders[0] != orders[1] && orders[1] != orders[2]);
        assert_eq!(orders[0], shuffled(100, Key::new(7)));
    }
}
