//! From predictions to scores.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::metrics::{Confusion, Scores};
use crate::predictions::Prediction;

/// The scores of one run over a set of clips. Where it was repeated with several seeds, scores are means over them.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// The classes' names, by their numbers.
    pub classes: Arc<[String]>,
    /// The seeds, in order; at least one.
    pub seeds: Vec<u64>,
    /// By recorded epoch, in order; at least one.
    pub epochs: Vec<EpochScores>,
    /// By fold, in order of dataset and subject.
    pub folds: Vec<FoldScores>,
}

/// Scores after one epoch.
#[derive(Debug, Clone, PartialEq)]
pub struct EpochScores {
    /// Number of previous epochs.
    pub epoch: usize,
    /// The paper's metrics, the mean over folds and seeds.
    pub mean: Scores,
    /// All folds' predictions pooled, for MEGC 2019's metrics: by seed.
    pub pooled: Vec<Confusion>,
}

impl EpochScores {
    /// Unweighted F1, the mean over seeds.
    pub fn uf1(&self) -> f64 {
        mean(self.pooled.iter().map(Confusion::uf1))
    }

    /// Unweighted average recall, the mean over seeds.
    pub fn uar(&self) -> f64 {
        mean(self.pooled.iter().map(Confusion::uar))
    }

    /// The predictions of all seeds.
    pub fn counts(&self) -> Confusion {
        let mut counts = Confusion::new(self.pooled.first().map_or(0, |confusion| confusion.0.len()));
        self.pooled.iter().for_each(|confusion| counts.add(confusion));
        counts
    }
}

/// One subject's clips.
#[derive(Debug, Clone, PartialEq)]
pub struct FoldScores {
    /// The dataset's kind.
    pub dataset: String,
    pub subject: String,
    /// By recorded epoch, then by seed.
    pub confusions: Vec<Vec<Confusion>>,
}

impl FoldScores {
    pub fn clips(&self) -> usize {
        self.confusions[0][0].total()
    }

    /// After the last epoch, by seed.
    pub fn last(&self) -> &[Confusion] {
        &self.confusions[self.confusions.len() - 1]
    }
}

/// The paper's metrics, the mean over seeds.
pub(crate) fn mean_scores(by_seed: &[Confusion]) -> Scores {
    Scores::mean(&by_seed.iter().map(Confusion::scores).collect::<Vec<_>>())
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// The largest value of a metric over the recorded epochs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Best {
    pub value: f64,
    /// The first epoch that reached it.
    pub epoch: usize,
}

/// Why predictions cannot be scored.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SummaryError {
    /// There are none.
    #[error("no predictions")]
    Empty,
    #[error(
        "{dataset} subject {subject} clip {clip} has {count} predictions at epoch {epoch}{}, expected 1: \
        the file is not whole",
        .seed.map(|seed| format!(" of seed {seed}")).unwrap_or_default()
    )]
    Count {
        /// The dataset's kind.
        dataset: String,
        subject: String,
        clip: String,
        /// Where there are several.
        seed: Option<u64>,
        epoch: usize,
        count: usize,
    },
    #[error(
        "{dataset} subject {subject} clip {clip} is {first} in one prediction and {second} in another: \
        a clip shows one class"
    )]
    Truth {
        /// The dataset's kind.
        dataset: String,
        subject: String,
        clip: String,
        /// The true class in its first prediction.
        first: String,
        /// The true class in a later one.
        second: String,
    },
}

type TruthAndPredicted = (usize, usize);
/// An epoch of a seed.
type Step = (usize, u64);

impl Summary {
    /// Scores of a whole run: every clip must be predicted once at every recorded epoch of every seed. Class numbers are indices into
    /// `classes`.
    ///
    /// # Errors
    /// When there are no predictions, too few or too many for a clip, or contradicting true classes.
    pub fn of(classes: &Arc<[String]>, predictions: &[Prediction]) -> Result<Self, SummaryError> {
        let epochs: BTreeSet<usize> = predictions.iter().map(|prediction| prediction.epoch).collect();
        let seeds: BTreeSet<u64> = predictions.iter().map(|prediction| prediction.seed).collect();
        let mut clips: BTreeMap<[&str; 3], BTreeMap<Step, usize>> = BTreeMap::new();
        let mut truths: BTreeMap<[&str; 3], usize> = BTreeMap::new();
        let mut folds: BTreeMap<[&str; 2], BTreeMap<Step, Vec<TruthAndPredicted>>> = BTreeMap::new();
        for Prediction { dataset, subject, clip, truth, seed, epoch, predicted, .. } in predictions {
            let step = (*epoch, *seed);
            *clips.entry([dataset, subject, clip]).or_default().entry(step).or_default() += 1;
            let first = *truths.entry([dataset, subject, clip]).or_insert(*truth);
            if first != *truth {
                let [dataset, subject, clip] = [dataset, subject, clip].map(String::clone);
                let [first, second] = [first, *truth].map(|class| classes[class].clone());
                return Err(SummaryError::Truth { dataset, subject, clip, first, second });
            }
            folds.entry([dataset, subject]).or_default().entry(step).or_default().push((*truth, *predicted));
        }
        for ([dataset, subject, clip], counts) in clips {
            for (&epoch, &seed) in epochs.iter().flat_map(|epoch| seeds.iter().map(move |seed| (epoch, seed)))
            {
                let count = counts.get(&(epoch, seed)).copied().unwrap_or(0);
                if count != 1 {
                    let [dataset, subject, clip] = [dataset, subject, clip].map(str::to_owned);
                    let seed = (seeds.len() > 1).then_some(seed);
                    return Err(SummaryError::Count { dataset, subject, clip, seed, epoch, count });
                }
            }
        }
        let folds: Vec<FoldScores> = folds
            .into_iter()
            .map(|([dataset, subject], steps)| {
                let confusions: Vec<Confusion> =
                    steps.into_values().map(|pairs| Confusion::of(classes.len(), pairs)).collect();
                FoldScores {
                    dataset: dataset.to_owned(),
                    subject: subject.to_owned(),
                    confusions: confusions.chunks(seeds.len()).map(<[Confusion]>::to_vec).collect(),
                }
            })
            .collect();
        let at = |(index, epoch)| {
            let confusions = folds.iter().map(|fold: &FoldScores| &fold.confusions[index]);
            Self::epoch_scores(classes.len(), epoch, confusions)
        };
        let epochs: Vec<EpochScores> = epochs.into_iter().enumerate().map(at).collect();
        if epochs.is_empty() {
            return Err(SummaryError::Empty);
        }
        Ok(Self { classes: classes.clone(), seeds: seeds.into_iter().collect(), epochs, folds })
    }

    /// Of the folds' confusions by seed.
    fn epoch_scores<'a>(
        classes: usize,
        epoch: usize,
        folds: impl Iterator<Item = &'a Vec<Confusion>>,
    ) -> EpochScores {
        let (mut scores, mut pooled): (Vec<Scores>, Vec<Confusion>) = (Vec::new(), Vec::new());
        for by_seed in folds {
            scores.push(mean_scores(by_seed));
            pooled.resize(by_seed.len(), Confusion::new(classes));
            pooled.iter_mut().zip(by_seed).for_each(|(pooled, confusion)| pooled.add(confusion));
        }
        EpochScores { epoch, mean: Scores::mean(&scores), pooled }
    }

    /// Number of clips.
    pub fn clips(&self) -> usize {
        self.last().pooled[0].total()
    }

    /// The paper's result: for each metric (in the order of [`Scores::values`]) the largest mean over folds, each at its own epoch.
    /// The epochs are chosen on the test clips themselves, so these numbers are optimistic.
    pub fn best(&self) -> [Best; 5] {
        std::array::from_fn(|metric| {
            let values = self.epochs.iter().map(|scores| (scores.mean.values()[metric], scores.epoch));
            let (value, epoch) = values.fold((f64::NEG_INFINITY, 0), |a, b| if b.0 > a.0 { b } else { a });
            Best { value, epoch }
        })
    }

    /// The result after the last epoch, which is fixed before training and independent of the test clips.
    pub fn last(&self) -> &EpochScores {
        &self.epochs[self.epochs.len() - 1]
    }

    /// ` after epoch 200`; nothing if no other epoch was recorded.
    pub(crate) fn after_last(&self) -> String {
        if self.epochs.len() > 1 { format!(" after epoch {}", self.last().epoch) } else { String::new() }
    }

    /// The most frequent class, the first of equal ones: the baseline predicts it for every clip.
    pub fn most_frequent_class(&self) -> usize {
        self.last().pooled[0].most_frequent()
    }

    /// Each fold's confusions if [`most_frequent_class`](Self::most_frequent_class) is always predicted, as of one seed.
    pub(crate) fn baseline_folds(&self) -> Vec<Vec<Confusion>> {
        let class = self.most_frequent_class();
        self.folds.iter().map(|fold| vec![fold.confusions[0][0].always(class)]).collect()
    }

    /// The scores of always predicting [`most_frequent_class`](Self::most_frequent_class).
    pub fn baseline(&self) -> EpochScores {
        Self::epoch_scores(self.classes.len(), 0, self.baseline_folds().iter())
    }
}
