//! How spotted intervals are scored: the protocol of the Micro-Expression Grand Challenges, and how public code counts.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use srflow_core::{named, serialize_as_text};
use srflow_data::micro_expression::intervals::{ExpressionKind, Interval};

use crate::metrics::Confusion;
use crate::statistics::{self, resampled};

/// How intervals are counted as found. An interval fits another of the same video if they share half of the frames that either has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CountingRule {
    /// Each prediction finds at most one expression of its type; the pairs that overlap most are matched first. Frames are
    /// inclusive.
    #[default]
    Strict,
    /// The same without regard to types: the type of a found expression is its own.
    AnyType,
    /// As `Strict`, but the last frame does not belong to an interval.
    Exclusive,
    /// Expressions that any prediction of their type fits, as the baseline of MEGC 2020 counts
    /// (HeyingGithub/Baseline-project-for-MEGC2020_spotting).
    Megc2020,
    /// Expressions that any prediction fits, of whatever type, as the code of MEGC 2021's winner counts
    /// (hitheyuhong/MEGC2024-CODE).
    OfFd,
}

named!(CountingRule, "a rule of counting", {
    Strict => "strict",
    AnyType => "any-type",
    Exclusive => "exclusive",
    Megc2020 => "megc2020",
    OfFd => "of-fd",
});
serialize_as_text!(CountingRule);

impl CountingRule {
    fn same_type(self) -> bool {
        !matches!(self, Self::AnyType | Self::OfFd)
    }

    fn one_to_one(self) -> bool {
        !matches!(self, Self::Megc2020 | Self::OfFd)
    }

    /// Frames in both intervals, and in either.
    fn frames(self, a: &Interval, b: &Interval) -> (u64, u64) {
        let last = i64::from(self != Self::Exclusive);
        let length = |first: i64, end: i64| (end + last - first).max(0).cast_unsigned();
        let both = length(a.onset.max(b.onset), a.offset.min(b.offset));
        (both, length(a.onset, a.offset) + length(b.onset, b.offset) - both)
    }
}

/// How the type of a prediction is decided. An expression of the truth always has the type that its dataset gives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PredictedTypes {
    /// As the file says.
    #[default]
    Given,
    /// Micro-expressions take at most 0.5 s from onset to offset.
    Duration,
    /// Micro-expressions take at most 0.5 s from onset to offset or 8/30 s from onset to apex.
    Rise,
}

named!(PredictedTypes, "a rule of types", { Given => "given", Duration => "duration", Rise => "rise" });
serialize_as_text!(PredictedTypes);

/// Sets the type of each interval by its length, in a video with so many frames per second.
pub fn retyped(intervals: &mut [Interval], types: PredictedTypes, fps: f64) {
    for interval in intervals {
        let short = (interval.offset - interval.onset) as f64 / fps <= 0.5;
        let fast = interval.apex.is_some_and(|apex| {
            (interval.onset..=interval.offset).contains(&apex)
                && (apex - interval.onset) as f64 / fps <= 8.0 / 30.0
        });
        let micro = match types {
            PredictedTypes::Given => continue,
            PredictedTypes::Duration => short,
            PredictedTypes::Rise => short || fast,
        };
        interval.kind = if micro { ExpressionKind::Micro } else { ExpressionKind::Macro };
    }
}

/// How many expressions were found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    pub found: usize,
    pub predicted: usize,
    pub truths: usize,
}

impl Counts {
    pub fn precision(&self) -> f64 {
        self.found as f64 / self.predicted.max(1) as f64
    }

    pub fn recall(&self) -> f64 {
        self.found as f64 / self.truths.max(1) as f64
    }

    /// `2 found / (predicted + truths)`; 0 without either.
    pub fn f1(&self) -> f64 {
        2.0 * self.found as f64 / (self.predicted + self.truths).max(1) as f64
    }

    fn plus(self, other: Self) -> Self {
        Self {
            found: self.found + other.found,
            predicted: self.predicted + other.predicted,
            truths: self.truths + other.truths,
        }
    }
}

/// The scores of one type of expression, or of all.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TypeScores {
    #[serde(flatten)]
    pub counts: Counts,
    pub precision: f64,
    pub recall: f64,
    pub f1: f64,
    /// Of F1: percentiles 2.5 and 97.5 of as many videos drawn with replacement.
    pub f1_interval: statistics::Interval,
}

/// How the emotions of found expressions were recognized (MEGC 2024's spot-then-recognize).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Analysis {
    /// Found expressions with an emotion.
    pub clips: usize,
    pub classes: Vec<String>,
    /// Mean precision and mean recall over the classes, with 0/0 = 0. The mean recall is UAR.
    pub precision: f64,
    pub recall: f64,
    /// Of these two means, not the mean of the classes' F1.
    pub f1: f64,
    /// Mean of the classes' F1.
    pub uf1: f64,
    /// F1 of spotting times F1 of analysis.
    pub strs: f64,
}

/// The scores of spotted intervals, pooled over all videos.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpottingScores {
    pub rule: CountingRule,
    pub videos: usize,
    pub micro: TypeScores,
    #[serde(rename = "macro")]
    pub macros: TypeScores,
    pub overall: TypeScores,
    /// Where both truth and predictions have emotions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub analysis: Option<Analysis>,
}

/// Compares predictions with the truth.
pub fn score_intervals(truths: &[Interval], predictions: &[Interval], rule: CountingRule) -> SpottingScores {
    let mut videos = BTreeMap::<&str, [Vec<&Interval>; 2]>::new();
    for (side, intervals) in [truths, predictions].into_iter().enumerate() {
        for interval in intervals {
            videos.entry(&interval.video).or_default()[side].push(interval);
        }
    }
    let (mut counts, mut pairs) = (Vec::with_capacity(videos.len()), Vec::new());
    for [truths, predictions] in videos.values() {
        let matched = matched(truths, predictions, rule);
        let of_kind = |kind: ExpressionKind| Counts {
            found: matched.iter().filter(|(truth, _)| truths[*truth].kind == kind).count(),
            predicted: predictions.iter().filter(|interval| interval.kind == kind).count(),
            truths: truths.iter().filter(|interval| interval.kind == kind).count(),
        };
        let [micro, macros] = ExpressionKind::ALL.map(of_kind);
        counts.push([micro, macros, micro.plus(macros)]);
        pairs.extend(matched.iter().map(|&(truth, prediction)| (truths[truth], predictions[prediction])));
    }
    let sum = |chosen: &mut dyn Iterator<Item = usize>| {
        chosen.fold([Counts::default(); 3], |sums, video| {
            std::array::from_fn(|kind| sums[kind].plus(counts[video][kind]))
        })
    };
    let pooled = sum(&mut (0..counts.len()));
    let intervals = resampled("bootstrap over videos", counts.len(), |chosen| {
        sum(&mut chosen.iter().copied()).map(|counts| counts.f1())
    });
    let of = |kind: usize| TypeScores {
        counts: pooled[kind],
        precision: pooled[kind].precision(),
        recall: pooled[kind].recall(),
        f1: pooled[kind].f1(),
        f1_interval: intervals[kind],
    };
    let overall = of(2);
    let named = |intervals: &[Interval]| intervals.iter().any(|interval| !interval.label.is_empty());
    let analysis = (named(truths) && named(predictions)).then(|| Analysis::of(truths, &pairs, overall.f1));
    SpottingScores { rule, videos: counts.len(), micro: of(0), macros: of(1), overall, analysis }
}

/// Pairs of a truth and a prediction of one video, by their places.
fn matched(truths: &[&Interval], predictions: &[&Interval], rule: CountingRule) -> Vec<(usize, usize)> {
    let mut fitting = Vec::new();
    for (t, truth) in truths.iter().enumerate() {
        for (p, prediction) in predictions.iter().enumerate() {
            let (both, either) = rule.frames(truth, prediction);
            let fits = both > 0 && 2 * both >= either;
            if fits && (!rule.same_type() || truth.kind == prediction.kind) {
                // Larger than any two fractions of 32-bit numbers are apart: equal only where they are.
                let share = (u128::from(both) << 64) / u128::from(either);
                fitting.push((Reverse(share), t, p));
            }
        }
    }
    fitting.sort_unstable();
    let (mut found, mut used) = (BTreeSet::new(), BTreeSet::new());
    let mut pairs = Vec::new();
    for (_, t, p) in fitting {
        if !found.contains(&t) && (!rule.one_to_one() || !used.contains(&p)) {
            found.insert(t);
            used.insert(p);
            pairs.push((t, p));
        }
    }
    pairs
}

impl Analysis {
    /// Of the emotions of matched pairs (truth, prediction). Emotions that the truth does not have count as wrong.
    fn of(truths: &[Interval], pairs: &[(&Interval, &Interval)], f1_spot: f64) -> Self {
        let key = |interval: &Interval| interval.label.trim().to_lowercase();
        let classes: BTreeSet<String> = truths.iter().map(key).filter(|label| !label.is_empty()).collect();
        let classes: Vec<String> = classes.into_iter().collect();
        let place = |interval: &Interval| classes.iter().position(|class| *class == key(interval));
        // The last class is that of unknown emotions, which no truth has.
        let unknown = classes.len();
        let numbers = pairs
            .iter()
            .filter_map(|(truth, prediction)| Some((place(truth)?, place(prediction).unwrap_or(unknown))));
        let confusion = Confusion::of(unknown + 1, numbers);
        let mean = |of: &dyn Fn(usize) -> f64| (0..unknown).map(of).sum::<f64>() / unknown.max(1) as f64;
        let precision = mean(&|class| confusion.precision(class));
        let recall = mean(&|class| confusion.recall(class));
        let f1 = if precision + recall > 0.0 { 2.0 * precision * recall / (precision + recall) } else { 0.0 };
        let uf1 = mean(&|class| confusion.f1(class));
        Self { clips: confusion.total(), classes, precision, recall, f1, uf1, strs: f1_spot * f1 }
    }
}
