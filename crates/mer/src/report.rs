//! The page of a run: scores, curves, confusions, subjects, and clips with their flow, strain and prediction.

use srflow_eval::report::{
    Axis, Chart, Curve, Figure, Panel, Picture, PictureError, Report, Section, columns, curves, facts,
    score_table, side_by_side,
};
use srflow_field::{FlowField, flow_colors};

use crate::features::{Channel, FEATURE_SIDE, Sample};
use crate::predictions::Trial;
use crate::results::{Outcome, by_set, confusion_table, fold_table, score_tables, unseen_classes};
use crate::strain::strain_colors;

/// Clips shown for each method and set.
const SHOWN_CLIPS: usize = 8;

/// What a page is made of.
pub struct ReportParts<'a> {
    /// Every run, those of one set together.
    pub outcomes: &'a [Outcome],
    /// Their predictions.
    pub trials: &'a [Trial],
    /// The features of each method.
    pub samples: &'a [(String, Vec<Sample>)],
    /// How the run was made: names and values.
    pub facts: Vec<(String, String)>,
    /// What the times were measured on.
    pub machine: String,
}

/// The page of one run.
///
/// # Errors
/// When a picture cannot be encoded.
pub fn report(parts: &ReportParts) -> Result<Report, PictureError> {
    let mut sections = Vec::new();
    for outcomes in by_set(parts.outcomes) {
        let set = &outcomes[0].set;
        let mut figures: Vec<Figure> =
            score_tables(&outcomes).iter().map(|table| score_table(table, TABLE_CAPTION)).collect();
        figures.push(side_by_side(vec![accuracies(&outcomes), losses(&outcomes)], 420));
        figures.push(side_by_side(
            outcomes.iter().map(|outcome| score_table(&confusion_table(outcome), "")).collect(),
            380,
        ));
        figures.extend(
            outcomes.iter().map(|outcome| {
                score_table(&fold_table(outcome), &unseen_classes(outcome).unwrap_or_default())
            }),
        );
        for trial in parts.trials.iter().filter(|trial| trial.set == *set) {
            if let Some((_, samples)) = parts.samples.iter().find(|(method, _)| *method == trial.method) {
                figures.push(clips(trial, samples)?);
            }
        }
        sections.push(Section { title: set.clone(), lead: SECTION_LEAD.to_owned(), figures });
    }
    sections.push(Section {
        title: "How it was made".to_owned(),
        lead:
            "Everything that decides the numbers above; predictions.csv has what every clip was told to be."
                .to_owned(),
        figures: vec![facts(&parts.facts)],
    });
    Ok(Report {
        title: "Micro-expression recognition".to_owned(),
        kicker: "srflow mer run".to_owned(),
        lead: "Every subject's clips are told by a classifier that was trained on all others.".to_owned(),
        opening: Vec::new(),
        sections,
        colophon: format!("srflow {} on {}.", env!("CARGO_PKG_VERSION"), parts.machine),
    })
}

const SECTION_LEAD: &str = "Scores are computed for each subject and averaged over subjects, as in the SRFlow paper; \
    UF1 and UAR are MEGC 2019's, of all subjects' predictions pooled.";

const TABLE_CAPTION: &str = "P, R and F1 are macro averages over the classes that a subject shows or is told to show, \
    F1_μ is the share of clips told right, G the geometric mean of the recalls. The best epoch is chosen by the clips that \
    are scored; the last epoch is not.";

fn accuracies(outcomes: &[&Outcome]) -> Figure {
    let mut lines: Vec<Curve> = outcomes
        .iter()
        .map(|outcome| Curve {
            name: outcome.method.clone(),
            points: outcome.summary.epochs.iter().map(|e| (e.epoch as f64, e.mean.accuracy)).collect(),
            baseline: false,
        })
        .collect();
    if let Some(first) = outcomes.first() {
        let accuracy = first.summary.always_negative().mean.accuracy;
        let points = first.summary.epochs.iter().map(|e| (e.epoch as f64, accuracy)).collect();
        lines.push(Curve { name: "always negative".to_owned(), points, baseline: true });
    }
    curves(&lines, Axis::Linear, true, &chart("Clips told right", "mean over subjects"))
}

fn losses(outcomes: &[&Outcome]) -> Figure {
    let line = |outcome: &&Outcome| {
        let mean = |index: usize| {
            let losses = outcome.folds.iter().filter_map(|fold| fold.training_losses.get(index));
            losses.sum::<f64>() / outcome.folds.len() as f64
        };
        let epochs = outcome.summary.epochs.iter().enumerate();
        Curve {
            name: outcome.method.clone(),
            points: epochs.map(|(index, e)| (e.epoch as f64, mean(index))).collect(),
            baseline: false,
        }
    };
    let lines: Vec<Curve> = outcomes.iter().map(line).collect();
    curves(&lines, Axis::Linear, true, &chart("Training loss", "cross-entropy, mean over folds"))
}

fn chart(title: &str, y: &str) -> Chart {
    Chart { title: title.to_owned(), x: "epoch".to_owned(), y: y.to_owned(), caption: String::new() }
}

/// Clips spread over the set, after the last epoch.
fn clips(trial: &Trial, samples: &[Sample]) -> Result<Figure, PictureError> {
    let last = trial.predictions.iter().map(|prediction| prediction.epoch).max();
    let of_last: Vec<_> = trial.predictions.iter().filter(|p| Some(p.epoch) == last).collect();
    let every = of_last.len().div_ceil(SHOWN_CLIPS).max(1);
    let mut shown = Vec::new();
    for prediction in of_last.into_iter().step_by(every) {
        let of_clip = |sample: &&Sample| {
            (&sample.dataset, &sample.subject, &sample.clip)
                == (&prediction.dataset, &prediction.subject, &prediction.clip)
        };
        let Some(sample) = samples.iter().find(of_clip) else { continue };
        let [u, v, strain] =
            [Channel::U, Channel::V, Channel::Strain].map(|channel| sample.features.plane(channel));
        let flow = FlowField::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| [u.get(x, y), v.get(x, y)]);
        let name = format!("{} {} {}", sample.dataset, sample.subject, sample.clip);
        let right = if prediction.predicted == prediction.truth { "right" } else { "wrong" };
        shown.push(vec![
            Panel {
                picture: Picture::exact(&flow_colors(&flow, None), &format!("flow of {name}"))?,
                title: name.clone(),
                note: "flow".to_owned(),
            },
            Panel {
                picture: Picture::exact(&strain_colors(&strain, None), &format!("strain of {name}"))?,
                title: right.to_owned(),
                note: format!("strain; {} told {}", prediction.truth, prediction.predicted),
            },
        ]);
    }
    let caption = format!(
        "{}: features of clips from every part of the set, and what they were told to be; each picture has its own scale.",
        trial.method
    );
    Ok(columns(&shown, 112, &caption))
}
