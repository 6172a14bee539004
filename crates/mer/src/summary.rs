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
    /// A clip has no prediction, or several, at a recorded epoch.
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
    /// A clip has different true classes.
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
            let pooled = confusions.fold(Confusion::new(classes.len()), Confusion::plus);
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

    /// The most frequent class, the first of equal ones: the baseline predicts it for every clip.
    pub fn most_frequent_class(&self) -> usize {
        self.last().pooled.most_frequent()
    }

    /// The scores of always predicting [`most_frequent_class`](Self::most_frequent_class).
    pub fn baseline(&self) -> EpochScores {
        let class = self.most_frequent_class();
        let confusions: Vec<Confusion> =
            self.folds.iter().map(|fold| fold.confusions[0].always(class)).collect();
        let scores: Vec<Scores> = confusions.iter().map(Confusion::scores).collect();
        EpochScores { epoch: 0, mean: Scores::mean(&scores), pooled: self.last().pooled.always(class) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEGATIVE: usize = 0;
    const POSITIVE: usize = 1;
    const SURPRISE: usize = 2;

    fn summary(predictions: &[Prediction]) -> Result<Summary, SummaryError> {
        Summary::of(&["negative", "positive", "surprise"].map(str::to_owned).into(), predictions)
    }

    fn prediction(subject: &str, clip: &str, epoch: usize, said: [usize; 2]) -> Prediction {
        Prediction {
            dataset: "made-up".into(),
            subject: subject.into(),
            clip: clip.into(),
            truth: said[0],
            epoch,
            predicted: said[1],
            scores: vec![0.0; 3],
        }
    }

    /// Two subjects, one of them with a single clip; two epochs.
    fn run() -> Vec<Prediction> {
        vec![
            prediction("1", "a", 0, [NEGATIVE, NEGATIVE]),
            prediction("1", "b", 0, [SURPRISE, NEGATIVE]),
            prediction("2", "a", 0, [POSITIVE, POSITIVE]),
            prediction("1", "a", 20, [NEGATIVE, SURPRISE]),
            prediction("1", "b", 20, [SURPRISE, SURPRISE]),
            prediction("2", "a", 20, [POSITIVE, NEGATIVE]),
        ]
    }

    #[test]
    fn each_metric_takes_its_own_epoch() {
        let mut predictions = run();
        // A third epoch: subject 1 as at first, subject 2 wrong.
        predictions.push(prediction("1", "a", 40, [NEGATIVE, NEGATIVE]));
        predictions.push(prediction("1", "b", 40, [SURPRISE, SURPRISE]));
        predictions.push(prediction("2", "a", 40, [POSITIVE, NEGATIVE]));
        let summary = summary(&predictions).unwrap();
        let best = summary.best();
        assert_eq!(best[3], Best { value: 0.75, epoch: 0 }); // accuracy: (1/2 + 1) / 2
        assert_eq!(best[1], Best { value: 0.75, epoch: 0 }); // recall
        assert_eq!(best[4], Best { value: 0.5, epoch: 0 }); // geometric mean: first of equals
        assert_eq!(summary.last().epoch, 40);
        assert_eq!(summary.last().mean.accuracy, 0.5);
        assert_eq!(summary.last().pooled, Confusion(vec![vec![1, 0, 0], vec![1, 0, 0], vec![0, 0, 1]]));
    }

    #[test]
    fn the_baseline_is_of_the_same_clips() {
        let summary = summary(&run()).unwrap();
        let baseline = summary.baseline();
        assert_eq!(baseline.pooled, Confusion(vec![vec![1, 0, 0], vec![1, 0, 0], vec![1, 0, 0]]));
        assert_eq!(baseline.mean.accuracy, 0.25);
        assert_eq!(summary.folds[1].confusions[0].total(), 1);
    }

    #[test]
    fn a_clip_that_is_missing_or_there_twice_or_doubtful_is_named() {
        assert_eq!(summary(&[]), Err(SummaryError::Empty));
        let mut twice = run();
        twice.push(twice[1].clone());
        let error = summary(&twice).unwrap_err().to_string();
        assert!(error.contains("subject 1 clip b has 2 predictions at epoch 0"), "{error}");
        let error = summary(&run()[..5]).unwrap_err().to_string();
        assert!(error.contains("subject 2 clip a has 0 predictions at epoch 20"), "{error}");
        let mut doubtful = run();
        doubtful[5].truth = SURPRISE;
        let error = summary(&doubtful).unwrap_err().to_string();
        assert!(error.contains("subject 2 clip a is positive in one prediction and surprise"), "{error}");
    }
}
