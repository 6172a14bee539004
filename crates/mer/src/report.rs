//! The page of a run: scores, curves, confusion matrices, subjects, and clips with face, flow, strain and prediction.

use srflow_core::{FlowField, Plane, flow_colors};
use srflow_data::micro_expression::Clip;
use srflow_report::html::{
    Axis, Chart, Curve, Figure, Page, Picture, PictureError, Section, Strip, confusion_matrix, curves, facts,
    ramp_legend, score_table, side_by_side, strips, wheel_legend,
};
use srflow_report::{color_scale, flow_scale, shrink_image};

use crate::extract::faces_of_clip;
use crate::extract_error::ExtractError;
use crate::face::FaceCrop;
use crate::features::{Channel, FEATURE_SIDE};
use crate::outcome::{Outcome, by_set};
use crate::predictions::{Prediction, Trial};
use crate::results::{baseline_name, confusion_name, fold_table, score_tables, unseen_classes};
use crate::sample::Sample;
use crate::strain::strain_colors;

/// Clips shown for each method and set.
const SHOWN_CLIPS: usize = 8;
/// Maximum width of a face, in pixels: twice the displayed size.
const FACE_WIDTH: usize = 224;

/// The contents of a page.
pub struct ReportParts<'a> {
    /// All runs, those of one set together.
    pub outcomes: &'a [Outcome],
    /// Rows of the tables that were asked for and are not there, a sentence each.
    pub left_out: &'a [String],
    pub trials: &'a [Trial],
    /// The features of each method.
    pub samples: &'a [(String, Vec<Sample>)],
    /// The clips of the features, on disk.
    pub clips: &'a [Clip],
    /// How faces were cropped out of their frames.
    pub face: &'a FaceCrop,
    /// Settings of the run: names and values.
    pub facts: Vec<(String, String)>,
    /// The machine that the times were measured on.
    pub machine: String,
}

/// Why the page could not be created.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A picture cannot be encoded.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A displayed frame cannot be read.
    #[error(transparent)]
    Clip(#[from] ExtractError),
}

/// The page of one run.
///
/// # Errors
/// When a frame cannot be read or a picture cannot be encoded.
pub fn report(parts: &ReportParts) -> Result<Page, ReportError> {
    let mut sections = Vec::new();
    for outcomes in by_set(parts.outcomes) {
        let set = &outcomes[0].set;
        let captions = std::iter::once(TABLE_CAPTION).chain(std::iter::repeat(""));
        let tables = score_tables(&outcomes, parts.left_out);
        let mut figures: Vec<Figure> =
            tables.iter().zip(captions).map(|(table, caption)| score_table(table, caption)).collect();
        if outcomes.iter().any(|outcome| outcome.summary.epochs.len() > 1) {
            figures.push(side_by_side(vec![accuracies(&outcomes), losses(&outcomes)], 420));
        }
        figures.push(side_by_side(outcomes.iter().map(|outcome| confusion(outcome)).collect(), 420));
        figures.extend(
            outcomes.iter().map(|outcome| {
                score_table(&fold_table(outcome), &unseen_classes(outcome).unwrap_or_default())
            }),
        );
        for trial in parts.trials.iter().filter(|trial| trial.set == *set) {
            if let Some((_, samples)) = parts.samples.iter().find(|(method, _)| *method == trial.method) {
                figures.extend(clips(parts, trial, samples)?);
            }
        }
        sections.push(Section::new(set.clone(), SECTION_LEAD, figures));
    }
    sections.push(Section::new(
        "How it was made",
        "Everything that the numbers above depend on; predictions.csv has the prediction for each clip.",
        vec![facts(&parts.facts)],
    ));
    Ok(Page {
        title: "Micro-expression recognition".to_owned(),
        kicker: "srflow mer run".to_owned(),
        lead: "Each subject's clips are classified by a model that has not seen the subject.".to_owned(),
        opening: Vec::new(),
        sections,
        colophon: format!("srflow {} on {}.", env!("CARGO_PKG_VERSION"), parts.machine),
    })
}

const SECTION_LEAD: &str = "Scores are computed for each held-out subject and averaged over subjects, as in the SRFlow \
    paper; UF1 and UAR are MEGC 2019's, computed from the pooled predictions.";

const TABLE_CAPTION: &str = "P, R and F1 are macro averages over the classes among a subject's labels and predictions, F1_μ \
    is the accuracy, G the geometric mean of the recalls. Intervals are bootstrapped over subjects. Where there are several epochs, \
    the last is fixed before training, and the best, chosen on the test clips themselves, is optimistic.";

fn confusion(outcome: &Outcome) -> Figure {
    let chart = Chart::new(
        format!("{}: {}", outcome.method, confusion_name(outcome)),
        "predicted class",
        "true class",
        "",
    );
    confusion_matrix(&outcome.summary.classes, &outcome.summary.last().counts().0, &chart)
}

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
        let accuracy = first.summary.baseline().mean.accuracy;
        let points = first.summary.epochs.iter().map(|e| (e.epoch as f64, accuracy)).collect();
        lines.push(Curve { name: baseline_name(first), points, baseline: true });
    }
    curves(&lines, Axis::Linear, true, &chart("Accuracy", "mean over subjects"))
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
    Chart::new(title, "epoch", y, "")
}

/// Clips spread over the set, after the last epoch; flow and strain have one common scale.
fn clips(parts: &ReportParts, trial: &Trial, samples: &[Sample]) -> Result<Vec<Figure>, ReportError> {
    let last = trial.predictions.iter().map(|prediction| prediction.epoch).max();
    let seed = trial.predictions.first().map(|prediction| prediction.seed);
    let shown = |p: &&Prediction| Some(p.epoch) == last && Some(p.seed) == seed;
    let of_last: Vec<&Prediction> = trial.predictions.iter().filter(shown).collect();
    let every = of_last.len().div_ceil(SHOWN_CLIPS).max(1);
    let shown: Vec<Shown> = of_last
        .into_iter()
        .step_by(every)
        .filter_map(|prediction| Shown::of(prediction, samples, parts.clips))
        .collect();
    let flow_max = shown.iter().map(|clip| flow_scale(&clip.flow)).fold(0.1, f64::max);
    let strains = shown.iter().flat_map(|clip| clip.strain.pixels().iter().copied());
    let strain_max = color_scale(strains, 1e-6);

    let strip = |clip: &Shown| -> Result<Strip, ReportError> {
        let Prediction { dataset, subject, clip: name, truth, predicted, .. } = clip.prediction;
        let name = format!("{dataset} {subject} {name}");
        let [truth, predicted] = [truth, predicted].map(|class| &trial.classes[*class]);
        let [onset, apex] = faces_of_clip(clip.clip, parts.face)?;
        let face =
            |image, alt: &str| Picture::jpeg(&shrink_image(image, FACE_WIDTH), &format!("{alt} of {name}"));
        let flow = flow_colors(&clip.flow, Some(flow_max as f32));
        let strain = strain_colors(&clip.strain, Some(strain_max as f32));
        let pictures = vec![
            (face(&onset, "onset")?, "onset".to_owned()),
            (face(&apex, "apex")?, "apex".to_owned()),
            (Picture::exact(&flow, &format!("flow of {name}"))?, "flow".to_owned()),
            (Picture::exact(&strain, &format!("strain of {name}"))?, "strain".to_owned()),
        ];
        let note = if truth == predicted {
            format!("{truth}, correctly classified")
        } else {
            format!("{truth}, classified as {predicted}")
        };
        Ok(Strip { title: name, note, pictures })
    };
    let shown: Vec<Strip> = shown.iter().map(strip).collect::<Result<_, _>>()?;
    let caption = format!(
        "{}: {} clips from every part of the set, each with the faces at onset and apex, the flow between them, its strain, \
         and the prediction after the last epoch.",
        trial.method,
        shown.len()
    );
    let ramp = strain_colors(&Plane::from_fn(256, 1, |x, _| x as f32 / 255.0), Some(1.0));
    let strain_words = format!("Optical strain, 0 to {strain_max} and more.");
    let legends = vec![
        wheel_legend(flow_max, "Pixels are those of the 112x112 feature map.")?,
        ramp_legend(&ramp, "colours of strain, from black through red and yellow to white", &strain_words)?,
    ];
    Ok(vec![strips(&shown, 420, &caption), side_by_side(legends, 420)])
}

/// The displayed data of a clip.
struct Shown<'a> {
    prediction: &'a Prediction,
    clip: &'a Clip,
    flow: FlowField,
    strain: Plane,
}

impl<'a> Shown<'a> {
    /// `None` if the features or frames of a prediction's clip are missing.
    fn of(prediction: &'a Prediction, samples: &[Sample], clips: &'a [Clip]) -> Option<Self> {
        let named = (&prediction.dataset, &prediction.subject, &prediction.clip);
        let sample =
            samples.iter().find(|sample| (&sample.dataset, &sample.subject, &sample.clip) == named)?;
        let of_clip =
            |clip: &&Clip| (&clip.dataset, &clip.annotation.subject, &clip.annotation.clip) == named;
        let [u, v, strain] =
            [Channel::U, Channel::V, Channel::Strain].map(|channel| sample.features.plane(channel));
        let flow = FlowField::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| [u.get(x, y), v.get(x, y)]);
        Some(Self { prediction, clip: clips.iter().find(of_clip)?, flow, strain })
    }
}
