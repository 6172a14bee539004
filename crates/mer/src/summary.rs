//! From predictions to scores.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::metrics::{Confusion, Scores};
use crate::predictions::Prediction;

/// The scores of one leave-one-subject-out run.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// The classes' names, by their numbers.
    pub classes: Arc<[String]>,
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
    /// The paper's metrics, the mean over folds.
    pub mean: Scores,
    /// All folds' predictions pooled, for MEGC 2019's metrics.
    pub pooled: Confusion,
}

/// One subject's clips.
#[derive(Debug, Clone, PartialEq)]
pub struct FoldScores {
    /// The dataset's kind.
    pub dataset: String,
    pub subject: String,
    /// By recorded epoch.
    pub confusions: Vec<Confusion>,
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
        "{dataset} subject {subject} clip {clip} has {count} predictions at epoch {epoch}, expected 1: \
        the file is not whole"
    )]
    Count {
        /// The dataset's kind.
        dataset: String,
        subject: String,
        clip: String,
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

impl Summary {
    /// Scores of a whole run: every clip must be predicted once at every recorded epoch. Class numbers are indices into `classes`.
    ///
    /// # Errors
    /// When there are no predictions, too few or too many for a clip, or contradicting true classes.
    pub fn of(classes: &Arc<[String]>, predictions: &[Prediction]) -> Result<Self, SummaryError> {
        let epochs: BTreeSet<usize> = predictions.iter().map(|prediction| prediction.epoch).collect();
        let mut clips: BTreeMap<[&str; 3], BTreeMap<usize, usize>> = BTreeMap::new();
        let mut truths: BTreeMap<[&str; 3], usize> = BTreeMap::new();
        let mut folds: BTreeMap<[&str; 2], BTreeMap<usize, Vec<TruthAndPredicted>>> = BTreeMap::new();
        for Prediction { dataset, subject, clip, truth, epoch, predicted, .. } in predictions {
            *clips.entry([dataset, subject, clip]).or_default().entry(*epoch).or_default() += 1;
            let first = *truths.entry([dataset, subject, clip]).or_insert(*truth);
            if first != *truth {
                let [dataset, subject, clip] = [dataset, subject, clip].map(String::clone);
                let [first, second] = [first, *truth].map(|class| classes[class].clone());
                return Err(SummaryError::Truth { dataset, subject, clip, first, second });
            }
            let fold = folds.entry([dataset, subject]).or_default();
            fold.entry(*epoch).or_default().push((*truth, *predicted));
        }
        for ([dataset, subject, clip], counts) in clips {
            for &epoch in &epochs {
                let count = counts.get(&epoch).copied().unwrap_or(0);
                if count != 1 {
                    let [dataset, subject, clip] = [dataset, subject, clip].map(str::to_owned);
                    return Err(SummaryError::Count { dataset, subject, clip, epoch, count });
                }
            }
        }
        let folds: Vec<FoldScores> = folds
            .into_iter()
            .map(|([dataset, subject], epochs)| FoldScores {
                dataset: dataset.to_owned(),
                subject: subject.to_owned(),
                confusions: epochs.into_values().map(|pairs| Confusion::of(classes.len(), pairs)).collect(),
            })
            .collect();
        let at = |(index, epoch)| {
            let confusions = folds.iter().map(|fold: &FoldScores| &fold.confusions[index]);
            let scores: Vec<Scores> = confusions.clone().map(Confusion::scores).collect();
            let mut pooled = Confusion::new(classes.len());
            confusions.for_each(|confusion| pooled.add(confusion));
            EpochScores { epoch, mean: Scores::mean(&scores), pooled }
        };
        let epochs: Vec<EpochScores> = epochs.into_iter().enumerate().map(at).collect();
        if epochs.is_empty() {
            Err(SummaryError::Empty)
        } else {
            Ok(Self { classes: classes.clone(), epochs, folds })
        }
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
        self.last().pooled.most_frequent()
    }

    /// Each fold's confusions if [`most_frequent_class`](Self::most_frequent_class) is always predicted.
    pub(crate) fn baseline_folds(&self) -> Vec<Confusion> {
        let class = self.most_frequent_class();
        self.folds.iter().map(|fold| fold.confusions[0].always(class)).collect()
    }

    /// The scores of always predicting [`most_frequent_class`](Self::most_frequent_class).
    pub fn baseline(&self) -> EpochScores {
        let class = self.most_frequent_class();
        let confusions = self.baseline_folds();
        let scores: Vec<Scores> = confusions.iter().map(Confusion::scores).collect();
        EpochScores { epoch: 0, mean: Scores::mean(&scores), pooled: self.last().pooled.always(class) }
    }
}
