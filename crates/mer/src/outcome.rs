//! One method's run over one set of clips, and its record.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::loso::{FoldRecord, Loso};
use crate::metrics::Scores;
use crate::predictions::Trial;
use crate::statistics::{Interval, MEASURES, SubjectScores};
use crate::summary::{EpochScores, FoldScores, Summary, SummaryError};

/// Keys and headers of the paper's metrics, in its order.
pub const METRICS: [(&str, &str); 5] =
    [("p_m", "P_M"), ("r_m", "R_M"), ("f1_m", "F1_M"), ("f1_mu", "F1_μ"), ("g_m", "G_M")];

/// Keys and headers of the paper's metrics and MEGC 2019's.
pub const MEASURE_KEYS: [(&str, &str); MEASURES] =
    [METRICS[0], METRICS[1], METRICS[2], METRICS[3], METRICS[4], ("uf1", "UF1"), ("uar", "UAR")];

/// One method's leave-one-subject-out run over one set of clips.
#[derive(Debug, Clone)]
pub struct Outcome {
    pub method: String,
    /// A dataset's name, or `composite`.
    pub set: String,
    /// Training of each fold; `None` if only the predictions are known.
    pub folds: Vec<FoldRecord>,
    pub summary: Summary,
}

impl Outcome {
    /// Scores a run.
    ///
    /// # Errors
    /// When its predictions are incomplete.
    pub fn of(method: &str, set: &str, loso: &Loso) -> Result<Self, SummaryError> {
        let summary = Summary::of(&loso.classes, &loso.predictions)?;
        Ok(Self { method: method.to_owned(), set: set.to_owned(), folds: loso.folds.clone(), summary })
    }

    /// Scores predictions without data on their training.
    ///
    /// # Errors
    /// When they are incomplete.
    pub fn of_trial(trial: &Trial) -> Result<Self, SummaryError> {
        let Trial { method, set, classes, predictions } = trial;
        let summary = Summary::of(classes, predictions)?;
        Ok(Self { method: method.clone(), set: set.clone(), folds: Vec::new(), summary })
    }

    /// Whether another run has the same subjects with the same clips.
    pub(crate) fn has_subjects_of(&self, other: &Self) -> bool {
        let subjects = |outcome: &Self| {
            let of = |fold: &FoldScores| (fold.dataset.clone(), fold.subject.clone(), fold.clips());
            outcome.summary.folds.iter().map(of).collect::<Vec<_>>()
        };
        self.set == other.set && subjects(self) == subjects(other)
    }

    /// The subjects' scores after the last epoch.
    pub(crate) fn last_scores(&self) -> SubjectScores {
        SubjectScores::new(self.summary.folds.iter().map(FoldScores::last))
    }

    /// The subjects' scores if the most frequent class is always predicted.
    pub(crate) fn chance_scores(&self) -> SubjectScores {
        SubjectScores::new(self.summary.baseline_folds().iter().map(Vec::as_slice))
    }

    /// The scores after the last epoch by seed, where there are several seeds.
    pub(crate) fn scores_by_seed(&self) -> Vec<(u64, [f64; MEASURES])> {
        let seeds = &self.summary.seeds;
        if seeds.len() < 2 {
            return Vec::new();
        }
        let of_seed = |number: usize| {
            let folds = self.summary.folds.iter().map(move |fold| &fold.last()[number..=number]);
            SubjectScores::new(folds).measures()
        };
        seeds.iter().enumerate().map(|(number, seed)| (*seed, of_seed(number))).collect()
    }

    /// Mean training loss over the folds with a subject's clips, after the last epoch; `None` if it is not known.
    pub(crate) fn training_loss(&self, fold: &FoldScores) -> Option<f64> {
        let of_fold = self.folds.iter().filter(|record| record.tested(&fold.dataset, &fold.subject));
        let losses: Vec<f64> = of_fold.filter_map(|record| record.training_losses.last().copied()).collect();
        (!losses.is_empty()).then(|| losses.iter().sum::<f64>() / losses.len() as f64)
    }

    /// All numbers, as JSON.
    pub fn record(&self) -> OutcomeRecord {
        let metric = |((key, _), best): (&(&'static str, &str), crate::summary::Best)| BestRecord {
            metric: key,
            value: best.value,
            epoch: best.epoch,
        };
        OutcomeRecord {
            method: self.method.clone(),
            set: self.set.clone(),
            best: METRICS.iter().zip(self.summary.best()).map(metric).collect(),
            last: EpochRecord::of(self.summary.last()),
            intervals: MEASURE_KEYS.iter().map(|(key, _)| *key).zip(self.last_scores().intervals()).collect(),
            seeds: self.scores_by_seed().into_iter().map(SeedRecord::of).collect(),
            epochs: self.summary.epochs.iter().map(EpochRecord::of).collect(),
            baseline: BaselineRecord {
                always: self.summary.classes[self.summary.most_frequent_class()].clone(),
                scores: EpochRecord::of(&self.summary.baseline()),
            },
            folds: self.folds.clone(),
        }
    }
}

/// The stored form of [`Outcome`].
#[derive(Debug, Clone, Serialize)]
pub struct OutcomeRecord {
    method: String,
    set: String,
    best: Vec<BestRecord>,
    last: EpochRecord,
    /// Of the scores after the last epoch, over subjects.
    intervals: BTreeMap<&'static str, Interval>,
    /// Of the last epoch, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    seeds: Vec<SeedRecord>,
    epochs: Vec<EpochRecord>,
    baseline: BaselineRecord,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    folds: Vec<FoldRecord>,
}

/// The scores of one seed.
#[derive(Debug, Clone, Serialize)]
struct SeedRecord {
    seed: u64,
    #[serde(flatten)]
    scores: BTreeMap<&'static str, f64>,
}

impl SeedRecord {
    fn of((seed, scores): (u64, [f64; MEASURES])) -> Self {
        Self { seed, scores: MEASURE_KEYS.iter().map(|(key, _)| *key).zip(scores).collect() }
    }
}

/// The baseline that always predicts one class.
#[derive(Debug, Clone, Serialize)]
struct BaselineRecord {
    always: String,
    #[serde(flatten)]
    scores: EpochRecord,
}

#[derive(Debug, Clone, Serialize)]
struct BestRecord {
    metric: &'static str,
    value: f64,
    epoch: usize,
}

#[derive(Debug, Clone, Serialize)]
struct EpochRecord {
    epoch: usize,
    #[serde(flatten)]
    mean: Scores,
    uf1: f64,
    uar: f64,
    /// `[truth][predicted]`, of all seeds.
    confusion: Vec<Vec<usize>>,
}

impl EpochRecord {
    fn of(scores: &EpochScores) -> Self {
        let (uf1, uar) = (scores.uf1(), scores.uar());
        Self { epoch: scores.epoch, mean: scores.mean, uf1, uar, confusion: scores.counts().0 }
    }
}

/// Groups outcomes by set; sets and outcomes are in order of first appearance.
pub fn by_set(outcomes: &[Outcome]) -> Vec<Vec<&Outcome>> {
    let mut sets: Vec<Vec<&Outcome>> = Vec::new();
    for outcome in outcomes {
        match sets.iter_mut().find(|set| set[0].set == outcome.set) {
            Some(set) => set.push(outcome),
            None => sets.push(vec![outcome]),
        }
    }
    sets
}
