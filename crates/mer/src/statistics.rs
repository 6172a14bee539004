//! How certain scores are: intervals over subjects, and paired tests between rows.
//!
//! Clips of one subject are alike, so subjects are drawn or exchanged, never clips.

use serde::Serialize;
use srflow_core::random::Key;

use crate::metrics::Confusion;
use crate::summary::mean_scores;

/// The paper's five metrics, then UF1 and UAR.
pub const MEASURES: usize = 7;

/// A difference is found where chance alone makes it, or a larger one, with less than this probability.
pub const SIGNIFICANCE: f64 = 0.05;

const RESAMPLES: usize = 2000;
const EXCHANGES: usize = 10_000;
/// Up to this number of subjects every exchange is counted.
const MOST_COUNTED: usize = 13;

/// Bounds of a score, which hold 95 % of its resampled values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    pub low: f64,
    pub high: f64,
}

/// The confusions of a row's subjects after an epoch, each by seed.
#[derive(Debug, Clone, PartialEq)]
pub struct SubjectScores {
    subjects: Vec<([f64; 5], Vec<Confusion>)>,
    classes: usize,
}

impl SubjectScores {
    /// Of the subjects' confusions by seed, all of the same number of classes.
    pub fn new<'a>(confusions: impl IntoIterator<Item = &'a [Confusion]>) -> Self {
        let of = |by_seed: &[Confusion]| (mean_scores(by_seed).values(), by_seed.to_vec());
        let subjects: Vec<_> = confusions.into_iter().map(of).collect();
        let classes = subjects.first().map_or(0, |(_, by_seed)| by_seed[0].0.len());
        Self { subjects, classes }
    }

    /// The scores of all subjects, means over seeds.
    pub fn measures(&self) -> [f64; MEASURES] {
        measures(self.classes, self.subjects.iter())
    }

    /// Percentiles 2.5 and 97.5 of the scores of as many subjects drawn with replacement, 2000 times.
    pub fn intervals(&self) -> [Interval; MEASURES] {
        resampled("bootstrap over subjects", self.subjects.len(), |chosen| {
            measures(self.classes, chosen.iter().map(|&subject| &self.subjects[subject]))
        })
    }

    /// For each score the probability of a difference at least this large, if it were chance which row each subject's predictions are of:
    /// a two-sided permutation test over subjects. All exchanges are counted for up to 13 subjects, otherwise
    /// 10,000 random ones. `other` has the same subjects in the same order.
    pub fn exchanged(&self, other: &Self) -> [f64; MEASURES] {
        assert_eq!(self.subjects.len(), other.subjects.len(), "rows are compared on the same subjects");
        let count = self.subjects.len();
        let observed = self.difference(other, |_| false);
        let mut at_least = [0_usize; MEASURES];
        let mut tried = 0;
        let mut tally = |differences: [f64; MEASURES]| {
            tried += 1;
            for ((number, found), observed) in at_least.iter_mut().zip(differences).zip(observed) {
                // Sums in another order differ in their last bits.
                *number += usize::from(found.abs() >= observed.abs() - 1e-12);
            }
        };
        if count <= MOST_COUNTED {
            (0..1_u32 << count)
                .for_each(|bits| tally(self.difference(other, |subject| bits >> subject & 1 == 1)));
        } else {
            let mut stream = Key::new(0).stream("exchanges of subjects");
            // The rows as they are count, too.
            tally(observed);
            for _ in 0..EXCHANGES {
                let exchanged: Vec<bool> = (0..count).map(|_| stream.below(2) == 1).collect();
                tally(self.difference(other, |subject| exchanged[subject]));
            }
        }
        at_least.map(|number| number as f64 / tried as f64)
    }

    /// The scores of this row minus those of the other, with some subjects exchanged between them.
    fn difference(&self, other: &Self, exchanged: impl Fn(usize) -> bool) -> [f64; MEASURES] {
        let pairs = || self.subjects.iter().zip(&other.subjects).enumerate();
        let exchanged = &exchanged;
        let first = pairs().map(move |(subject, (a, b))| if exchanged(subject) { b } else { a });
        let second = pairs().map(move |(subject, (a, b))| if exchanged(subject) { a } else { b });
        let (first, second) = (measures(self.classes, first), measures(self.classes, second));
        std::array::from_fn(|measure| first[measure] - second[measure])
    }
}

/// Percentiles 2.5 and 97.5 of what is measured of `count` units drawn with replacement, 2000 times.
pub(crate) fn resampled<const N: usize>(
    purpose: &str,
    count: usize,
    measured: impl Fn(&[usize]) -> [f64; N],
) -> [Interval; N] {
    let mut stream = Key::new(0).stream(purpose);
    let mut drawn: [Vec<f64>; N] = std::array::from_fn(|_| Vec::with_capacity(RESAMPLES));
    for _ in 0..RESAMPLES {
        let chosen: Vec<usize> = (0..count).map(|_| stream.below(count as u32) as usize).collect();
        drawn.iter_mut().zip(measured(&chosen)).for_each(|(values, value)| values.push(value));
    }
    drawn.map(|mut values| {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[(share * (RESAMPLES - 1) as f64).round() as usize];
        Interval { low: at(0.025), high: at(0.975) }
    })
}

fn measures<'a>(
    classes: usize,
    subjects: impl Iterator<Item = &'a ([f64; 5], Vec<Confusion>)> + Clone,
) -> [f64; MEASURES] {
    let seeds = subjects.clone().map(|(_, by_seed)| by_seed.len()).max().unwrap_or(1);
    let (mut sums, mut count) = ([0.0; 5], 0);
    let mut pooled = vec![Confusion::new(classes); seeds];
    for (scores, by_seed) in subjects {
        sums.iter_mut().zip(scores).for_each(|(sum, score)| *sum += score);
        // A row of one seed stands beside each seed of another.
        pooled.iter_mut().zip(by_seed.iter().cycle()).for_each(|(pooled, confusion)| pooled.add(confusion));
        count += 1;
    }
    let mean = |of: fn(&Confusion) -> f64| pooled.iter().map(of).sum::<f64>() / seeds as f64;
    let [p, r, f1, accuracy, g] = sums.map(|sum| sum / f64::from(count.max(1)));
    [p, r, f1, accuracy, g, mean(Confusion::uf1), mean(Confusion::uar)]
}

/// Probabilities of several tests, raised so that the chance of any false finding among them stays as it is for one (Holm, *A simple
/// sequentially rejective multiple test procedure*, 1979).
pub fn holm(probabilities: &[f64]) -> Vec<f64> {
    let count = probabilities.len();
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| probabilities[a].total_cmp(&probabilities[b]));
    let mut raised = vec![0.0; count];
    let mut greatest: f64 = 0.0;
    for (rank, test) in order.into_iter().enumerate() {
        greatest = greatest.max((probabilities[test] * (count - rank) as f64).min(1.0));
        raised[test] = greatest;
    }
    raised
}
