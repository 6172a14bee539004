//! The training samples: pairs, or clips of consecutive pairs, of a mix of datasets, in files or made, reshuffled every epoch and
//! augmented.
//!
//! The sample at a place of a batch and its augmentation depend only on the seed, the step and the place, so any sample can be
//! made on any thread, in any order.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use srflow_core::Size;
use srflow_core::random::Key;
use srflow_data::flow::{DatasetError, DatasetSpec, Entry, FlowDataset, Sample, Split, TruthDensity};

use crate::augment::Augmentation;
use crate::config::{Config, DataSpec, Source};
use crate::data_error::DataError;
use crate::made::{Made, OpenMade};

const NO_TRUTH_ADVICE: &str = "choose a split whose truth is published, or for a plain folder put a flow beside each pair \
                               (docs/guides/train.md)";

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
    data: Data,
    times: usize,
    augmentation: Augmentation,
}

enum Data {
    Files {
        dataset: FlowDataset,
        /// Indices of the first pairs of samples all of whose pairs have a true flow.
        first_pairs: Vec<usize>,
    },
    Made(Made),
}

/// An augmented and cropped pair.
#[derive(Debug, Clone)]
pub struct TrainingSample {
    /// File of the first frame, or the number of a made pair, which identifies it.
    pub name: String,
    /// Of the random choices for the sample: its scene is the step, its frame the place in the batch.
    pub key: Key,
    pub sample: Sample,
}

impl TrainingSet {
    /// Lists the samples of every dataset of `data.train`, and opens data that is made with `open_made`.
    ///
    /// # Errors
    /// When `data.train` is empty, a dataset cannot be listed or opened, none of its pairs has a true flow, or it has no clips as long
    /// as the configuration says.
    pub fn open(config: &Config, open_made: &OpenMade) -> Result<Self, DataError> {
        if config.data.train.is_empty() {
            return Err(DataError::NoData);
        }
        let parts = config.data.train.iter().map(|source| Part::open(source, config, open_made));
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

    /// One line per dataset: name, split and number of pairs or clips in an epoch.
    pub fn describe(&self) -> Vec<String> {
        let words = |part: &Part| {
            let times = if part.times == 1 { String::new() } else { format!(", {} times each", part.times) };
            let of_frames = match self.pairs {
                1 => "pairs".to_owned(),
                pairs => format!("clips of {} frames", pairs + 1),
            };
            match &part.data {
                Data::Files { dataset, first_pairs } => {
                    let count = first_pairs.len();
                    format!("{} ({}): {count} {of_frames}{times}", dataset.name(), dataset.split())
                }
                Data::Made(made) => {
                    format!(
                        "{} (made while training): {} new {of_frames} an epoch{times}",
                        made.name(),
                        made.samples()
                    )
                }
            }
        };
        self.parts.iter().map(words).collect()
    }

    /// The pairs of the sample at `place`, from 0, of the batch of `step`, from 0, all with the same augmentation.
    ///
    /// # Errors
    /// When its files cannot be read, it cannot be made, or its frames are smaller than half the crop.
    pub fn sample(&self, step: u64, place: usize, batch: usize) -> Result<Vec<TrainingSample>, DataError> {
        let steps = self.steps_per_epoch(batch);
        let epoch = step / steps;
        let order = self.order(epoch);
        let position = (step % steps) as usize * batch + place;
        let (part, number) = self.part(order[position % order.len()]);
        let key = Key::new(self.seed).scene(step as u32).frame(place as u32);
        match &part.data {
            Data::Files { dataset, first_pairs } => {
                let first = first_pairs[number];
                let read = |entry: &Entry| {
                    let name = entry.frame1.path().display().to_string();
                    self.augmented(part, name, dataset.read(entry)?, key)
                };
                dataset.entries()[first..first + self.pairs].iter().map(read).collect()
            }
            Data::Made(made) => {
                let pairs = made.sample(epoch, number)?.into_iter();
                pairs.map(|(name, sample)| self.augmented(part, name, sample, key)).collect()
            }
        }
    }

    fn augmented(
        &self,
        part: &Part,
        name: String,
        sample: Sample,
        key: Key,
    ) -> Result<TrainingSample, DataError> {
        let frame @ Size { width, height } = sample.frame1.size();
        if 2 * width < self.crop.width || 2 * height < self.crop.height {
            return Err(DataError::TooSmall { pair: name, frame, crop: self.crop });
        }
        match part.augmentation.apply(sample, key) {
            Ok(sample) => Ok(TrainingSample { name, key, sample }),
            Err(source) => Err(DataError::Augment { pair: name, source }),
        }
    }

    /// Numbers of the samples of an epoch, shuffled. Those of made data have their own order, at the places that the shuffle gives
    /// them.
    fn order(&self, epoch: u64) -> Arc<[usize]> {
        let mut orders = self.orders.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(order) = orders.get(&epoch) {
            return order.clone();
        }
        let key = Key::new(self.seed).scene(epoch as u32);
        let mut order = shuffled(self.samples(), key);
        let mut start = 0;
        for (number, part) in (0..).zip(&self.parts) {
            let end = start + part.samples();
            if let Data::Made(made) = &part.data {
                let places = order.iter_mut().filter(|sample| (start..end).contains(*sample));
                for (place, sample) in places.zip(made.order(part.times, key.frame(number))) {
                    *place = start + sample;
                }
            }
            start = end;
        }
        let order: Arc<[usize]> = order.into();
        orders.insert(epoch, order.clone());
        // Prefetching never reaches further than the next epoch.
        orders.retain(|&other, _| other.abs_diff(epoch) <= 1);
        order
    }

    /// The part of a sample, and the sample's number in the part without repetitions.
    fn part(&self, mut number: usize) -> (&Part, usize) {
        let mut parts = self.parts.iter();
        loop {
            let part = parts.next().expect("a number below the samples of all parts");
            if number < part.samples() {
                return (part, number % part.different());
            }
            number -= part.samples();
        }
    }
}

impl Part {
    fn open(source: &Source, config: &Config, open_made: &OpenMade) -> Result<Self, DataError> {
        let (data, density) = match &source.spec {
            DataSpec::Files(spec) => {
                let dataset = open_dataset(spec, source.split, Split::Train)?;
                let density = dataset.density();
                (Data::files(dataset, config)?, density)
            }
            DataSpec::Made(spec) => (Data::Made(Made::open(spec, config, open_made)?), TruthDensity::Dense),
        };
        let settings = config.augmentation.settings(density, config.data.crop);
        let augmentation = Augmentation::new(settings).map_err(DataError::Settings)?;
        Ok(Self { data, times: source.times, augmentation })
    }

    /// Samples, without repetitions.
    fn different(&self) -> usize {
        match &self.data {
            Data::Files { first_pairs, .. } => first_pairs.len(),
            Data::Made(made) => made.samples(),
        }
    }

    fn samples(&self) -> usize {
        self.different() * self.times
    }
}

impl Data {
    fn files(dataset: FlowDataset, config: &Config) -> Result<Self, DataError> {
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
        Ok(Self::Files { dataset, first_pairs })
    }
}

/// Whether all pairs have a true flow and each continues the one before.
fn is_clip(pairs: &[Entry]) -> bool {
    pairs.iter().all(|pair| pair.flow.is_some())
        && pairs.windows(2).all(|two| two[0].frame2 == two[1].frame1 && two[0].scene == two[1].scene)
}

/// Opens a split of a dataset, by default the split `usual`, or all pairs of a dataset without splits.
pub(crate) fn open_dataset(
    spec: &DatasetSpec,
    split: Option<Split>,
    usual: Split,
) -> Result<FlowDataset, DatasetError> {
    if split.is_some() {
        return FlowDataset::open(spec, split);
    }
    let error = match FlowDataset::open(spec, Some(usual)) {
        Ok(dataset) => return Ok(dataset),
        Err(error) => error,
    };
    match FlowDataset::open(spec, None) {
        Ok(dataset) if dataset.split() == Split::All => Ok(dataset),
        // A plain folder need not have subfolders for splits, so the error about the folder itself is the useful one.
        Err(plain) if spec.kind == "folder" && !spec.dir.join(usual.to_string()).is_dir() => Err(plain),
        _ => Err(error),
    }
}

/// `0..count` in a random order.
fn shuffled(count: usize, key: Key) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    key.stream("training order").shuffle(&mut order);
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_contains_every_pair_once_and_differs_between_epochs() {
        let orders: Vec<_> = (0..3).map(|epoch| shuffled(100, Key::new(7).scene(epoch))).collect();
        for order in &orders {
            let mut sorted = order.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..100).collect::<Vec<_>>());
        }
        assert!(orders[0] != orders[1] && orders[1] != orders[2]);
        assert_eq!(orders[0], shuffled(100, Key::new(7)));
    }
}
