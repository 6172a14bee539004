//! Results as CSV: one row for each number of a table, so that any program can read them.

use serde::Serialize;
use srflow_report::csv_text;

use crate::comparison::{Comparison, comparisons};
use crate::outcome::{MEASURE_KEYS, METRICS, Outcome, by_set};
use crate::results::baseline_name;
use crate::statistics::MEASURES;
use crate::summary::mean_scores;

/// The rows of [`crate::score_tables`]: `scored` is `last`, with bounds over subjects, `seed N` for one of
/// several seeds, or `best`, where each metric has its own epoch.
pub fn scores_csv(outcomes: &[Outcome]) -> String {
    type Scores = [Option<f64>; MEASURES];
    const NONE: Scores = [None; MEASURES];
    let mut lines = Vec::new();
    for of_set in by_set(outcomes) {
        let first = of_set[0];
        for outcome in of_set.iter().copied() {
            let Outcome { method, set, summary, .. } = outcome;
            let last = outcome.last_scores();
            let intervals = last.intervals();
            let (low, high) = (intervals.map(|i| Some(i.low)), intervals.map(|i| Some(i.high)));
            let epoch = Some(summary.last().epoch);
            lines.push((set, method.clone(), "last".to_owned(), epoch, last.measures().map(Some), low, high));
            for (seed, scores) in outcome.scores_by_seed() {
                let scored = format!("seed {seed}");
                lines.push((set, method.clone(), scored, epoch, scores.map(Some), NONE, NONE));
            }
            if summary.epochs.len() > 1 {
                let best = summary.best();
                let best = std::array::from_fn(|measure| best.get(measure).map(|best| best.value));
                lines.push((set, method.clone(), "best".to_owned(), None, best, NONE, NONE));
            }
        }
        // A baseline has no epoch.
        let baseline = first.chance_scores().measures().map(Some);
        lines.push((&first.set, baseline_name(first), "last".to_owned(), None, baseline, NONE, NONE));
    }
    let keys = || MEASURE_KEYS.iter().map(|(key, _)| *key);
    let bounds = ["low", "high"].iter().flat_map(|end| keys().map(move |key| format!("{key}_{end}")));
    let bounds: Vec<String> = bounds.collect();
    let names = ["set", "method", "scored", "epoch"].into_iter().chain(keys());
    text(&names.chain(bounds.iter().map(String::as_str)).collect::<Vec<_>>(), &lines)
}

/// Every pair of rows of each set with its [`Comparison`](crate::Comparison)s.
pub fn comparisons_csv(outcomes: &[Outcome]) -> String {
    let found = by_set(outcomes).into_iter().flat_map(|of_set| comparisons(&of_set));
    let lines: Vec<_> = found
        .map(|Comparison { set, methods: [first, second], metric, difference, p }| {
            (set, first, second, metric, difference, p)
        })
        .collect();
    text(&["set", "method", "other", "metric", "difference", "p"], &lines)
}

/// Each subject's scores after the last epoch.
pub fn folds_csv(outcomes: &[Outcome]) -> String {
    let mut lines = Vec::new();
    for outcome in outcomes {
        let Outcome { method, set, summary, .. } = outcome;
        for fold in &summary.folds {
            let (clips, epoch, scores) =
                (fold.clips(), summary.last().epoch, mean_scores(fold.last()).values());
            let loss = outcome.training_loss(fold);
            lines.push((set, method, &fold.dataset, &fold.subject, clips, epoch, scores, loss));
        }
    }
    let names = ["set", "method", "dataset", "subject", "clips", "epoch"];
    text(&[&names[..], &METRICS.map(|(key, _)| key), &["training_loss"]].concat(), &lines)
}

/// Confusion matrices after the last epoch, all folds pooled: one line per true class. All outcomes must have the classes of the
/// first.
pub fn confusions_csv(outcomes: &[Outcome]) -> String {
    let classes = outcomes.first().map_or(&[][..], |outcome| &outcome.summary.classes);
    let predicted: Vec<String> = classes.iter().map(|class| format!("predicted_{class}")).collect();
    let predicted: Vec<&str> = predicted.iter().map(String::as_str).collect();
    let mut lines = Vec::new();
    for Outcome { method, set, summary, .. } in outcomes {
        let last = summary.last();
        for (truth, counts) in summary.classes.iter().zip(&last.counts().0) {
            let mut line = vec![set.clone(), method.clone(), last.epoch.to_string(), truth.clone()];
            line.extend(counts.iter().map(usize::to_string));
            lines.push(line);
        }
    }
    text(&[&["set", "method", "epoch", "truth"], &predicted[..]].concat(), &lines)
}

/// A line of names, then these, whose fields have none.
fn text<L: Serialize>(names: &[&str], lines: &[L]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(names).expect("memory does not fail");
    for line in lines {
        writer.serialize(line).expect("lines of one form go to memory");
    }
    let bytes = writer.into_inner().expect("memory does not fail");
    let mut lines = csv::ReaderBuilder::new().has_headers(false).from_reader(&bytes[..]);
    let cells = lines.records().map(|line| line.expect("as written").iter().map(str::to_owned).collect());
    csv_text(cells)
}
