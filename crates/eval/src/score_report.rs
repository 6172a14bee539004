//! An evaluation as figures: tables, curves, times, and omitted pairs.

use srflow_report::html::{
    Axis, Bar, Chart, Curve, Figure, Page, Section, bars, curves, facts, number, score_table, side_by_side,
    titled_facts,
};

use crate::error_curve::PER_PIXEL;
use crate::results::{Evaluation, Failure, MethodScores};

/// The tables, curves and times of an evaluation. `machine` describes the machine that the times were measured on.
pub fn score_figures(evaluation: &Evaluation, machine: &str) -> Vec<Figure> {
    let tables = evaluation.tables();
    let mut figures: Vec<Figure> = tables
        .iter()
        .enumerate()
        .map(|(place, table)| score_table(table, if place == 0 { TABLE_CAPTION } else { "" }))
        .collect();
    let mut charts = vec![error_curves(evaluation)];
    if evaluation.pairs > 1 {
        charts.push(pair_curves(evaluation));
    }
    if evaluation.methods.iter().any(|method| !method.baseline && method.median_seconds().is_some()) {
        charts.push(times(evaluation, machine));
    }
    figures.push(side_by_side(charts, 420));
    if !evaluation.failures.is_empty() {
        figures.push(left_out(evaluation));
    }
    figures
}

/// The page of one evaluation: its tables and charts, then `pairs`, figures of single pairs from
/// [`pair_figures`](crate::pair_figures()), and last `settings`, names and values that reproduce the scores.
pub fn score_report(
    evaluation: &Evaluation,
    machine: &str,
    pairs: Vec<Figure>,
    settings: &[(String, String)],
) -> Page {
    let mut sections = vec![Section::new(
        "Scores",
        "Computed per pair over the pixels with ground truth, then averaged over pairs.",
        score_figures(evaluation, machine),
    )];
    if !pairs.is_empty() {
        sections.push(Section::new("Pairs", "The true flow, the flow of each method, and its error.", pairs));
    }
    sections.push(Section::new(
        "Settings",
        "Everything that reproduces these scores.",
        vec![facts(settings)],
    ));
    Page {
        title: format!("Optical flow of {} on {}", methods_in_words(evaluation), evaluation.title()),
        kicker: "srflow eval".to_owned(),
        lead: format!("{} of {}.", evaluation.pairs_in_words(), evaluation.folder),
        opening: Vec::new(),
        sections,
        colophon: format!("srflow {} on {machine}.", env!("CARGO_PKG_VERSION")),
    }
}

/// `raft`, `raft and gma`, `raft, gma and tvl1`, `5 methods`.
fn methods_in_words(evaluation: &Evaluation) -> String {
    let names: Vec<&str> = evaluation
        .methods
        .iter()
        .filter(|method| !method.baseline)
        .map(|method| method.name.as_str())
        .collect();
    match names[..] {
        [] => "the baseline".to_owned(),
        [ref first @ .., last] if (1..3).contains(&first.len()) => format!("{} and {last}", first.join(", ")),
        [one] => one.to_owned(),
        _ => format!("{} methods", names.len()),
    }
}

const TABLE_CAPTION: &str = "EPE is the mean end-point error in pixels; px1, px3 and px5 are the shares of pixels \
    with an error under 1, 3 and 5 pixels; F1-ALL is the percentage of pixels with an error over 3 pixels and over \
    5 % of the true length; WAUC is the area under the curve of pixels within an error, small errors weighing most. The \
    baseline “zero” is zero flow.";

fn error_curves(evaluation: &Evaluation) -> Figure {
    let curve = |method: &MethodScores| Curve {
        name: method.name.clone(),
        points: std::iter::once((0.0, f64::NAN))
            .chain(
                method
                    .within
                    .iter()
                    .enumerate()
                    .map(|(i, share)| ((i + 1) as f64 / PER_PIXEL, 100.0 * share)),
            )
            .collect(),
        baseline: method.baseline,
    };
    let chart = Chart::new(
        "Pixels within an error",
        "end-point error, px",
        "pixels within it, %",
        "Higher and further left is better. WAUC is the weighted area under this curve.",
    );
    curves(&evaluation.methods.iter().map(curve).collect::<Vec<_>>(), Axis::Linear, false, &chart)
}

fn pair_curves(evaluation: &Evaluation) -> Figure {
    let curve = |method: &MethodScores| Curve {
        name: method.name.clone(),
        points: (1..)
            .zip(&method.pairs)
            .filter_map(|(place, pair)| Some((f64::from(place), pair.whole.as_ref()?.epe)))
            .collect(),
        baseline: method.baseline,
    };
    let chart = Chart::new(
        "Error pair by pair",
        "pair",
        "EPE, px (logarithmic)",
        "Zero flow scores the mean length of the true flow: where motion is small, every method is near it.",
    );
    let dots = evaluation.pairs <= 60;
    curves(&evaluation.methods.iter().map(curve).collect::<Vec<_>>(), Axis::Logarithmic, dots, &chart)
}

fn times(evaluation: &Evaluation, machine: &str) -> Figure {
    let bar = |method: &MethodScores| {
        let seconds = method.median_seconds()?;
        let label = if seconds < 1.0 {
            format!("{} ms", number((1e4 * seconds).round() / 10.0))
        } else {
            format!("{seconds:.2} s")
        };
        Some(Bar { name: method.name.clone(), value: seconds, label, baseline: method.baseline })
    };
    let measured = evaluation.methods.iter().filter(|method| !method.baseline);
    let chart = Chart::new(
        "Time per pair",
        "",
        "",
        format!("Median over {} of the estimation alone, on {machine}.", evaluation.pairs_in_words()),
    );
    bars(&measured.filter_map(bar).collect::<Vec<_>>(), &chart)
}

fn left_out(evaluation: &Evaluation) -> Figure {
    let failure = |failure: &Failure| (failure.pair.clone(), failure.reason.clone());
    titled_facts("Left out of every row", &evaluation.failures.iter().map(failure).collect::<Vec<_>>())
}
