//! Results as CSV: one row for each number of a table, so that any program can read them.

use serde::Serialize;
use srflow_report::csv_text;

use crate::results::{METRICS, Outcome, baseline_name, by_set};
use crate::summary::EpochScores;

/// The rows of [`crate::score_tables`]: `scored` is `best`, where each metric has its own epoch, or `last`.
pub fn scores_csv(outcomes: &[Outcome]) -> String {
    let mut lines = Vec::new();
    for of_set in by_set(outcomes) {
        let first = of_set[0];
        for Outcome { method, set, summary, .. } in of_set.iter().copied() {
            let best = summary.best().map(|best| best.value);
            lines.push((set, method.clone(), "best", None, best, [None; 2]));
            let (epoch, scores, pooled) = after_last(summary.last());
            lines.push((set, method.clone(), "last", Some(epoch), scores, pooled));
        }
        // A baseline has no epoch.
        let (_, scores, pooled) = after_last(&first.summary.baseline());
        lines.push((&first.set, baseline_name(first), "last", None, scores, pooled));
    }
    let names = ["set", "method", "scored", "epoch"];
    text(&[&names[..], &METRICS.map(|(key, _)| key), &["uf1", "uar"]].concat(), &lines)
}

fn after_last(EpochScores { epoch, mean, pooled }: &EpochScores) -> (usize, [f64; 5], [Option<f64>; 2]) {
    (*epoch, mean.values(), [pooled.uf1(), pooled.uar()].map(Some))
}

/// Each subject's scores after the last epoch.
pub fn folds_csv(outcomes: &[Outcome]) -> String {
    let mut lines = Vec::new();
    for Outcome { method, set, folds, summary } in outcomes {
        for (number, fold) in summary.folds.iter().enumerate() {
            let confusion = &fold.confusions[fold.confusions.len() - 1];
            let (clips, epoch, scores) =
                (confusion.total(), summary.last().epoch, confusion.scores().values());
            let loss = folds.get(number).and_then(|fold| fold.training_losses.last().copied());
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
        for (truth, counts) in summary.classes.iter().zip(&last.pooled.0) {
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
