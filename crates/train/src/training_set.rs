//! The pairs that are trained on: a mix of datasets, shuffled in every epoch, each pair augmented.
//!
//! Which pair comes when, and how it is changed, depends on the seed, the step and the place in the batch alone. Any
//! sample can be made on its own, on any thread, in any order.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use srflow_field::Size;
use srflow_field::random::Key;
use srflow_read::augment::{AugmentError, Augmentation};
use srflow_read::flow::{DatasetError, FlowDataset, Sample, Split};

use crate::config::{Config, Source};

/// Why there is nothing to train on, or a pair could not be used.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    #[error(
        "data.train is empty: name what to train on, e.g. --data srflow:DIR, or --data folder:DIR for a plain folder of \
         pairs"
    )]
    NoData,
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(
        "{dataset} in {}: none of its {pairs} pairs has a true flow to learn from; {advice}", .dir.display()
    )]
    NoTruth { dataset: String, dir: PathBuf, pairs: usize, advice: &'static str },
    #[error(
        "{pair}: its frames are {}x{}, less than half of the crop {crop} (WIDTHxHEIGHT); set data.crop (--crop) to a size \
         that the frames have",
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

/// What to do about a dataset without flow.
const NO_TRUTH_ADVICE: &str = "choose a split whose truth is published, or for a plain folder put a flow beside each pair \
                               (docs/training.md)";

/// The pairs that are trained on.
pub struct TrainingSet {
    parts: Vec<Part>,
    crop: Size,
    seed: u64,
    /// The orders of the epochs that are in use.
    orders: Mutex<BTreeMap<u64, Arc<[usize]>>>,
}

/// One dataset of the mix.
struct Part {
    dataset: FlowDataset,
    /// The pairs with a true flow, by their place in the dataset.
    with_truth: Vec<usize>,
    times: usize,
    augmentation: Augmentation,
}

/// A pair as training sees it.
#[derive(Debug, Clone)]
pub struct TrainingSample {
    /// File of the first frame, which identifies the pair.
    pub name: String,
    /// Augmented and cropped.
    pub sample: Sample,
}

impl TrainingSet {
    /// Lists the pairs of every dataset of `data.train`.
    ///
    /// # Errors
    /// When there is none, one cannot be listed or has no true flow.
    pub fn open(config: &Config) -> Result<Self, DataError> {
        if config.data.train.is_empty() {
            return Err(DataError::NoData);
        }
        let parts = config.data.train.iter().map(|source| Part::open(source, config));
        Ok(Self {
            parts: parts.collect::<Result<_, _>>()?,
            crop: config.data.crop,
            seed: config.training.seed,
            orders: Mutex::default(),
        })
    }

    /// Pairs in an epoch, those that come several times counted as often.
    pub fn pairs(&self) -> usize {
        self.parts.iter().map(Part::pairs).sum()
    }

    /// Steps in an epoch; what does not fill a batch is left out. A set smaller than a batch fills it by coming again.
    pub fn steps_per_epoch(&self, batch: usize) -> u64 {
        (self.pairs() / batch).max(1) as u64
    }

    /// Each dataset with its split and pairs, for people.
    pub fn describe(&self) -> Vec<String> {
        let words = |part: &Part| {
            let times = if part.times == 1 { String::new() } else { format!(", {} times each", part.times) };
            let dataset = &part.dataset;
            format!("{} ({}): {} pairs{times}", dataset.name(), dataset.split(), part.with_truth.len())
        };
        self.parts.iter().map(words).collect()
    }

    /// The pair at `place` of the batch of `step`.
    ///
    /// # Errors
    /// When its files cannot be read or its frames are far too small for the crop.
    pub fn sample(&self, step: u64, place: usize, batch: usize) -> Result<TrainingSample, DataError> {
        let steps = self.steps_per_epoch(batch);
        let order = self.order(step / steps);
        let position = (step % steps) as usize * batch + place;
        let (part, entry) = self.pair(order[position % order.len()]);
        let entry = &part.dataset.entries()[entry];
        let name = entry.frame1.display().to_string();
        let sample = part.dataset.read(entry)?;
        let frame @ (width, height) = sample.frame1.size();
        if 2 * width < self.crop.width || 2 * height < self.crop.height {
            return Err(DataError::TooSmall { pair: name, frame, crop: self.crop });
        }
        let key = Key::new(self.seed).scene(step as u32).frame(place as u32);
        match part.augmentation.apply(sample, key) {
            Ok(sample) => Ok(TrainingSample { name, sample }),
            Err(source) => Err(DataError::Augment { pair: name, source }),
        }
    }

    /// The pairs of an epoch in their order.
    fn order(&self, epoch: u64) -> Arc<[usize]> {
        let mut orders = self.orders.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(order) = orders.get(&epoch) {
            return order.clone();
        }
        let order = shuffled(self.pairs(), Key::new(self.seed).scene(epoch as u32));
        orders.insert(epoch, order.clone());
        // Reading ahead is never more than an epoch away.
        orders.retain(|&other, _| other.abs_diff(epoch) <= 1);
        order
    }

    fn pair(&self, mut number: usize) -> (&Part, usize) {
        let mut parts = self.parts.iter();
        loop {
            let part = parts.next().expect("a number below the pairs of all parts");
            if number < part.pairs() {
                return (part, part.with_truth[number % part.with_truth.len()]);
            }
            number -= part.pairs();
        }
    }
}

impl Part {
    fn open(source: &Source, config: &Config) -> Result<Self, DataError> {
        let dataset = open_dataset(source, Split::Train)?;
        let entries = dataset.entries();
        let with_truth: Vec<usize> = (0..entries.len()).filter(|&i| entries[i].flow.is_some()).collect();
        if with_truth.is_empty() {
            return Err(DataError::NoTruth {
                dataset: format!("{} ({})", dataset.name(), dataset.split()),
                dir: dataset.dir().to_owned(),
                pairs: entries.len(),
                advice: NO_TRUTH_ADVICE,
            });
        }
        let settings = config.augmentation.settings(dataset.density(), config.data.crop);
        let augmentation = Augmentation::new(settings).map_err(DataError::Settings)?;
        Ok(Self { dataset, with_truth, times: source.times, augmentation })
    }

    fn pairs(&self) -> usize {
        self.with_truth.len() * self.times
    }
}

/// The split asked for, else the `usual` one, else all pairs of a dataset without splits.
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
        // A plain folder need not have a folder of the split: the problem is that of the folder itself.
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
    fn an_order_holds_every_pair_once_and_changes_with_the_epoch() {
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
