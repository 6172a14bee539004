//! A run as a page: curves of losses and scores, and what the run was asked for.

use srflow_eval::report::{Axis, Chart, Curve, Figure, Page, Section, curves, facts, tiles};

use crate::config::Config;
use crate::training_log::{Record, StepRecord, ValidationRecord};

/// Points of a curve of steps; more are averaged together.
const POINTS: usize = 300;

/// The page of a run that wrote down these records. `machine` says what it ran on.
pub fn report(config: &Config, records: &[Record], machine: &str) -> Page {
    let steps: Vec<&StepRecord> = records
        .iter()
        .filter_map(|record| if let Record::Step(step) = record { Some(step) } else { None })
        .collect();
    let validations: Vec<&ValidationRecord> = records
        .iter()
        .filter_map(|record| if let Record::Validation(scores) = record { Some(scores) } else { None })
        .collect();
    let mut sections = vec![training(&steps)];
    if !validations.is_empty() {
        sections.insert(0, validation(&validations));
    }
    sections.push(Section {
        title: "Configuration".to_owned(),
        lead: "Every key. `config.toml` beside this page is the same as a file.".to_owned(),
        figures: vec![facts(&configuration(config))],
    });
    let network = config.network.architecture.facts().title;
    Page {
        title: format!("Training {network}"),
        kicker: "srflow train".to_owned(),
        lead: format!("{} on {}.", network, sources(config)),
        opening: vec![tiles(&numbers(&steps, &validations))],
        sections,
        colophon: format!("Made by srflow {} on {machine}.", env!("CARGO_PKG_VERSION")),
    }
}

fn sources(config: &Config) -> String {
    config.data.train.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn numbers(steps: &[&StepRecord], validations: &[&ValidationRecord]) -> Vec<(String, String)> {
    let seconds: f64 = steps.iter().map(|step| step.seconds).sum();
    let waited: f64 = steps.iter().map(|step| step.waited).sum();
    let mut numbers = vec![
        (steps.len().to_string(), "steps".to_owned()),
        (format!("{:.2}", steps.len() as f64 / seconds.max(f64::MIN_POSITIVE)), "steps a second".to_owned()),
        (format!("{:.1}%", 100.0 * waited / seconds.max(f64::MIN_POSITIVE)), "waiting for data".to_owned()),
    ];
    let best = validations.iter().filter(|scores| scores.dataset == validations[0].dataset);
    if let Some(best) = best.min_by(|a, b| a.whole.epe.total_cmp(&b.whole.epe)) {
        numbers
            .push((format!("{:.4} px", best.whole.epe), format!("EPE after step {}, the best", best.step)));
        numbers.push((format!("{:.4} px", best.zero_epe), "EPE when nothing moves".to_owned()));
    }
    numbers
}

fn validation(validations: &[&ValidationRecord]) -> Section {
    let mut datasets: Vec<&str> = validations.iter().map(|scores| scores.dataset.as_str()).collect();
    datasets.sort_unstable();
    datasets.dedup();
    let chart = |title: &str, y: &str, caption: &str| Chart {
        title: title.to_owned(),
        x: "step".to_owned(),
        y: y.to_owned(),
        caption: caption.to_owned(),
    };
    let of =
        |dataset: &str, name: &str, baseline: bool, value: &dyn Fn(&ValidationRecord) -> Option<f64>| Curve {
            name: name.to_owned(),
            points: validations
                .iter()
                .filter(|scores| scores.dataset == dataset)
                .filter_map(|scores| Some((scores.step as f64, value(scores)?)))
                .collect(),
            baseline,
        };
    let figures = datasets.iter().flat_map(|dataset| {
        let mut epe = vec![
            of(dataset, "all pixels", false, &|scores| Some(scores.whole.epe)),
            of(dataset, "zero flow", true, &|scores| Some(scores.zero_epe)),
        ];
        if validations.iter().any(|scores| scores.dataset == *dataset && scores.head.is_some()) {
            epe.insert(1, of(dataset, "inside the head mask", false, &|scores| Some(scores.head?.epe)));
        }
        let shares = [
            of(dataset, "px1", false, &|scores| Some(scores.whole.px1)),
            of(dataset, "px3", false, &|scores| Some(scores.whole.px3)),
            of(dataset, "px5", false, &|scores| Some(scores.whole.px5)),
        ];
        let wauc = [of(dataset, "WAUC", false, &|scores| Some(scores.whole.wauc))];
        [
            curves(&epe, Axis::Logarithmic, true, &chart(dataset, "EPE, px", "Mean end-point error.")),
            curves(
                &shares,
                Axis::Linear,
                true,
                &chart(dataset, "share", "Pixels within 1, 3 and 5 px of the truth."),
            ),
            curves(
                &wauc,
                Axis::Linear,
                true,
                &chart(dataset, "WAUC", "Weighted area under the curve of errors."),
            ),
        ]
    });
    Section {
        title: "Validation".to_owned(),
        lead: "Scores on pairs that were not trained on, as in the paper's tables.".to_owned(),
        figures: figures.collect(),
    }
}

fn training(steps: &[&StepRecord]) -> Section {
    let names: Vec<&str> =
        steps.first().map_or(Vec::new(), |step| step.parts.iter().map(|(name, _)| name.as_str()).collect());
    let mut losses = vec![averaged(steps, "total", &|step| step.loss)];
    if names.len() > 1 {
        losses
            .extend(names.iter().enumerate().map(|(i, name)| averaged(steps, name, &|step| step.parts[i].1)));
    }
    let figure = |lines: &[Curve], axis, title: &str, y: &str, caption: &str| -> Figure {
        let chart = Chart {
            title: title.to_owned(),
            x: "step".to_owned(),
            y: y.to_owned(),
            caption: caption.to_owned(),
        };
        curves(lines, axis, false, &chart)
    };
    let epe = [averaged(steps, "last prediction", &|step| step.epe)];
    let norm = [averaged(steps, "before clipping", &|step| step.gradient_norm)];
    let rate = [averaged(steps, "learning rate", &|step| step.learning_rate)];
    Section {
        title: "Training".to_owned(),
        lead: "Each point is a mean over the steps around it.".to_owned(),
        figures: vec![
            figure(&losses, Axis::Logarithmic, "Loss", "loss", "What is minimised, and its parts."),
            figure(
                &epe,
                Axis::Logarithmic,
                "Training error",
                "EPE, px",
                "Mean end-point error on the augmented crops.",
            ),
            figure(&norm, Axis::Logarithmic, "Gradients", "norm", "Norm of all gradients together."),
            figure(&rate, Axis::Linear, "Learning rate", "rate", "One cycle: up, then down."),
        ],
    }
}

fn averaged(steps: &[&StepRecord], name: &str, value: &dyn Fn(&StepRecord) -> f64) -> Curve {
    let together = steps.len().div_ceil(POINTS).max(1);
    let point = |steps: &[&StepRecord]| {
        let mean = |value: &dyn Fn(&StepRecord) -> f64| {
            steps.iter().map(|step| value(step)).sum::<f64>() / steps.len() as f64
        };
        (mean(&|step| step.step as f64), mean(value))
    };
    Curve { name: name.to_owned(), points: steps.chunks(together).map(point).collect(), baseline: false }
}

/// Keys with their sections, and values.
fn configuration(config: &Config) -> Vec<(String, String)> {
    let mut section = String::new();
    let mut pairs = Vec::new();
    for line in config.to_toml().lines() {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            section = name.to_owned();
        } else if let Some((key, value)) = line.split_once(" = ") {
            pairs.push((format!("{section}.{key}"), value.to_owned()));
        }
    }
    pairs
}
