//! Rows of a table, held against each other and against chance.

use serde::Serialize;

use crate::outcome::{MEASURE_KEYS, Outcome};
use crate::statistics::{MEASURES, SIGNIFICANCE, SubjectScores, holm};

/// A paired test between two rows of one set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The dataset's name, or `composite`.
    pub set: String,
    /// The flow method of each row.
    pub methods: [String; 2],
    /// Key of the score.
    pub metric: &'static str,
    /// The first row's score minus the second's.
    pub difference: f64,
    /// Probability of such a difference by chance, corrected for the pairs of rows.
    pub p: f64,
}

/// Every pair of rows of one set, score by score; pairs of different subjects are left out.
pub fn comparisons(outcomes: &[&Outcome]) -> Vec<Comparison> {
    let pairs = || (0..outcomes.len()).flat_map(|a| (a + 1..outcomes.len()).map(move |b| (a, b)));
    let scores: Vec<SubjectScores> = outcomes.iter().map(|outcome| outcome.last_scores()).collect();
    let tests: Vec<(usize, usize, [f64; MEASURES])> = pairs()
        .filter(|&(a, b)| outcomes[a].has_subjects_of(outcomes[b]))
        .map(|(a, b)| (a, b, scores[a].exchanged(&scores[b])))
        .collect();
    let mut found = Vec::new();
    for (measure, &(metric, _)) in MEASURE_KEYS.iter().enumerate() {
        let raised = holm(&tests.iter().map(|(.., p)| p[measure]).collect::<Vec<_>>());
        for ((a, b, _), p) in tests.iter().zip(raised) {
            found.push(Comparison {
                set: outcomes[*a].set.clone(),
                methods: [*a, *b].map(|row| outcomes[row].method.clone()),
                metric,
                difference: scores[*a].measures()[measure] - scores[*b].measures()[measure],
                p,
            });
        }
    }
    found
}

/// Which scores to mark, by row: the best of each metric and those that do not differ significantly from it. A metric without
/// significant differences has no marks, nor has one whose best is no better than always predicting the most frequent class.
pub(crate) fn marked(outcomes: &[&Outcome], comparisons: &[Comparison]) -> Vec<[bool; MEASURES]> {
    let scores: Vec<SubjectScores> = outcomes.iter().map(|outcome| outcome.last_scores()).collect();
    let values: Vec<[f64; MEASURES]> = scores.iter().map(SubjectScores::measures).collect();
    let mut marked = vec![[false; MEASURES]; outcomes.len()];
    for (measure, &(metric, _)) in MEASURE_KEYS.iter().enumerate() {
        let best = (0..values.len())
            .fold(0, |best, row| if values[row][measure] > values[best][measure] { row } else { best });
        let Some(outcome) = outcomes.get(best) else { continue };
        let chance = outcome.chance_scores();
        let beyond = values[best][measure] > chance.measures()[measure]
            && scores[best].exchanged(&chance)[measure] < SIGNIFICANCE;
        let apart = |row: usize| {
            let methods = [&outcome.method, &outcomes[row].method];
            let between = |comparison: &&Comparison| {
                comparison.metric == metric
                    && methods.iter().all(|method| comparison.methods.contains(method))
            };
            comparisons.iter().find(between).is_some_and(|comparison| comparison.p < SIGNIFICANCE)
        };
        let group: Vec<bool> = (0..values.len()).map(|row| row == best || !apart(row)).collect();
        if beyond && group.contains(&false) {
            marked.iter_mut().zip(group).for_each(|(row, mark)| row[measure] = mark);
        }
    }
    marked
}
