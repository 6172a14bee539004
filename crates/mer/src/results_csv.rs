//! Results as CSV: one row for each number of a table, so that any program can read them.

use serde::Serialize;

use crate::metrics::Scores;
use crate::results::{Outcome, baseline_name, by_set};
use crate::summary::EpochScores;

#[derive(Serialize)]
struct ScoreLine<'a> {
    set: &'a str,
    method: &'a str,
    scored: &'a str,
    epoch: Option<usize>,
    p_m: f64,
    r_m: f64,
    f1_m: f64,
    f1_mu: f64,
    g_m: f64,
    uf1: Option<f64>,
    uar: Option<f64>,
}

#[derive(Serialize)]
struct FoldLine<'a> {
    set: &'a str,
    method: &'a str,
    dataset: &'a str,
    subject: &'a str,
    clips: usize,
    epoch: usize,
    p_m: f64,
    r_m: f64,
    f1_m: f64,
    f1_mu: f64,
    g_m: f64,
    training_loss: Option<f64>,
}

/// The rows of [`crate::score_tables`]: `scored` is `best`, where each metric has its own epoch, or `last`.
pub fn scores_csv(outcomes: &[Outcome]) -> String {
    let mut lines = Vec::new();
    let sets = by_set(outcomes);
    let names: Vec<String> = sets.iter().map(|of_set| baseline_name(of_set[0])).collect();
    for (number, of_set) in sets.iter().enumerate() {
        let set = &of_set[0].set;
        for Outcome { method, summary, .. } in of_set.iter().copied() {
            let [p_m, r_m, f1_m, f1_mu, g_m] = summary.best().map(|best| best.value);
            let best = ScoreLine {
                set,
                method,
                scored: "best",
                epoch: None,
                p_m,
                r_m,
                f1_m,
                f1_mu,
                g_m,
                uf1: None,
                uar: None,
            };
            lines.push(best);
            lines.push(ScoreLine {
                epoch: Some(summary.last().epoch),
                ..after_last(set, method, summary.last())
            });
        }
        let baseline = after_last(set, &names[number], &of_set[0].summary.baseline());
        lines.push(baseline);
    }
    text(&lines)
}

/// Without an epoch: a baseline has none.
fn after_last<'a>(set: &'a str, method: &'a str, scores: &EpochScores) -> ScoreLine<'a> {
    let Scores { precision, recall, f1, accuracy, g_mean } = scores.mean;
    ScoreLine {
        set,
        method,
        scored: "last",
        epoch: None,
        p_m: precision,
        r_m: recall,
        f1_m: f1,
        f1_mu: accuracy,
        g_m: g_mean,
        uf1: Some(scores.pooled.uf1()),
        uar: Some(scores.pooled.uar()),
    }
}

/// Each subject's scores after the last epoch.
pub fn folds_csv(outcomes: &[Outcome]) -> String {
    let mut lines = Vec::new();
    for Outcome { method, set, folds, summary } in outcomes {
        for (number, fold) in summary.folds.iter().enumerate() {
            let confusion = &fold.confusions[fold.confusions.len() - 1];
            let Scores { precision, recall, f1, accuracy, g_mean } = confusion.scores();
            lines.push(FoldLine {
                set,
                method,
                dataset: &fold.dataset,
                subject: &fold.subject,
                clips: confusion.total(),
                epoch: summary.last().epoch,
                p_m: precision,
                r_m: recall,
                f1_m: f1,
                f1_mu: accuracy,
                g_m: g_mean,
                training_loss: folds.get(number).and_then(|fold| fold.training_losses.last().copied()),
            });
        }
    }
    text(&lines)
}

/// Confusion matrices after the last epoch, all folds pooled: a line for each true class. The classes are those of the first
/// outcome; all have the same.
pub fn confusions_csv(outcomes: &[Outcome]) -> String {
    let classes = outcomes.first().map_or(&[][..], |outcome| &outcome.summary.classes);
    let mut lines = vec![["set", "method", "epoch", "truth"].map(str::to_owned).to_vec()];
    lines[0].extend(classes.iter().map(|class| format!("predicted_{class}")));
    for Outcome { method, set, summary, .. } in outcomes {
        let last = summary.last();
        for (truth, counts) in summary.classes.iter().zip(&last.pooled.0) {
            let mut line = vec![set.clone(), method.clone(), last.epoch.to_string(), truth.clone()];
            line.extend(counts.iter().map(usize::to_string));
            lines.push(line);
        }
    }
    text(&lines)
}

fn text<L: Serialize>(lines: &[L]) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for line in lines {
        writer.serialize(line).expect("lines of one form go to memory");
    }
    let bytes = writer.into_inner().expect("memory does not fail");
    String::from_utf8(bytes).expect("fields are strings")
}
