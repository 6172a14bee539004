//! The HTML report of a run: curves of losses and scores, and the configuration.

use srflow_report::html::{Axis, Chart, Curve, Figure, Page, Section, curves, settings_facts, tiles};

use crate::config::Config;
use crate::loss::{REGULARIZERS, cyclic, strain};
use crate::training_log::{Record, StepRecord, ValidationRecord};

/// The report of a run from the records of its log. `machine` describes the hardware.
pub fn report(config: &Config, records: &[Record], machine: &str) -> Page {
    let steps: Vec<&StepRecord> = records
        .iter()
        .filter_map(|record| if let Record::Step(step) = record { Some(step) } else { None })
        .collect();
    let validations: Vec<&ValidationRecord> = records
        .iter()
        .filter_map(|record| if let Record::Validation(scores) = record { Some(scores) } else { None })
        .collect();
    let mut sections = vec![training(config, &steps)];
    if !validations.is_empty() {
        sections.insert(0, validation(&validations));
    }
    sections.push(Section::new(
        "Configuration",
        "All settings of the run, as in `config.toml` next to this page.",
        vec![settings_facts(&config.to_toml())],
    ));
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
        (
            format!("{:.2}", steps.len() as f64 / seconds.max(f64::MIN_POSITIVE)),
            "steps per second".to_owned(),
        ),
        (format!("{:.1}%", 100.0 * waited / seconds.max(f64::MIN_POSITIVE)), "waiting for data".to_owned()),
    ];
    let best = validations.iter().filter(|scores| scores.dataset == validations[0].dataset);
    if let Some(best) = best.min_by(|a, b| a.whole.epe.total_cmp(&b.whole.epe)) {
        numbers
            .push((format!("{:.4} px", best.whole.epe), format!("EPE after step {}, the best", best.step)));
        numbers.push((format!("{:.4} px", best.zero_epe), "EPE of zero flow".to_owned()));
    }
    numbers
}

fn validation(validations: &[&ValidationRecord]) -> Section {
    let mut datasets: Vec<&str> = validations.iter().map(|scores| scores.dataset.as_str()).collect();
    datasets.sort_unstable();
    datasets.dedup();
    let figures = datasets.iter().flat_map(|dataset| {
        let records = || validations.iter().filter(|scores| scores.dataset == *dataset);
        let of = |name: &str, value: &dyn Fn(&ValidationRecord) -> Option<f64>| Curve {
            name: name.to_owned(),
            points: records().filter_map(|scores| Some((scores.step as f64, value(scores)?))).collect(),
            baseline: false,
        };
        let mut epe = vec![of("all pixels", &|scores| Some(scores.whole.epe))];
        if records().any(|scores| scores.head.is_some()) {
            epe.push(of("inside the head mask", &|scores| Some(scores.head?.epe)));
        }
        epe.push(Curve { baseline: true, ..of("zero flow", &|scores| Some(scores.zero_epe)) });
        let shares = [
            of("px1", &|scores| Some(scores.whole.px1)),
            of("px3", &|scores| Some(scores.whole.px3)),
            of("px5", &|scores| Some(scores.whole.px5)),
        ];
        let wauc = [of("WAUC", &|scores| Some(scores.whole.wauc))];
        let chart = |y, caption| chart(dataset, y, caption);
        [
            curves(&epe, Axis::Logarithmic, true, &chart("EPE, px", "Mean end-point error.")),
            curves(&shares, Axis::Linear, true, &chart("share", "Pixels within 1, 3 and 5 px of the truth.")),
            curves(&wauc, Axis::Linear, true, &chart("WAUC", "Weighted area under the error curve.")),
        ]
    });
    Section::new("Validation", "Scores on held-out pairs, as in the paper's tables.", figures.collect())
}

fn training(config: &Config, steps: &[&StepRecord]) -> Section {
    let names: Vec<&str> =
        steps.first().map_or(Vec::new(), |step| step.parts.iter().map(|(name, _)| name.as_str()).collect());
    let mut losses = vec![averaged(steps, "total", &|step| step.loss)];
    if names.len() > 1 {
        // An edited log may lack a part.
        let part = |step: &StepRecord, name: &str| {
            step.parts.iter().find(|(other, _)| other == name).map_or(f64::NAN, |(_, value)| *value)
        };
        losses.extend(names.iter().map(|name| averaged(steps, name, &|step| part(step, name))));
    }
    let figure = |lines: &[Curve], axis, title: &str, y: &str, caption: &str| -> Figure {
        curves(lines, axis, false, &chart(title, y, caption))
    };
    let epe = [averaged(steps, "last prediction", &|step| step.epe)];
    let norm = [averaged(steps, "before clipping", &|step| step.gradient_norm)];
    let rate = [averaged(steps, "learning rate", &|step| step.learning_rate)];
    let epe_caption = "Mean end-point error on the augmented crops.";
    Section::new(
        "Training",
        "Each point is a mean over the steps around it.",
        vec![
            figure(&losses, Axis::Logarithmic, "Loss", "loss", &loss_caption(config)),
            figure(&epe, Axis::Logarithmic, "Training error", "EPE, px", epe_caption),
            figure(&norm, Axis::Logarithmic, "Gradients", "norm", "Norm of all gradients."),
            figure(&rate, Axis::Linear, "Learning rate", "rate", "One cycle: up, then down."),
        ],
    )
}

/// Describes the parts of the loss and their weights.
fn loss_caption(config: &Config) -> String {
    let mut caption = format!("The minimised loss. sequence: {}", config.loss.sequence.description);
    for regularizer in REGULARIZERS.iter().filter(|regularizer| config.loss.weight(regularizer) != 0.0) {
        let (name, weight) = (regularizer.name, config.loss.weight(regularizer));
        caption.push_str(&format!(". {name}, times {weight}: {}", regularizer.description));
    }
    let others = [
        (strain::NAME, config.loss.strain, strain::DESCRIPTION),
        (cyclic::NAME, config.loss.cyclic, cyclic::DESCRIPTION),
    ];
    for (name, weight, description) in others.into_iter().filter(|(_, weight, _)| *weight != 0.0) {
        caption.push_str(&format!(". {name}, times {weight}: {description}"));
    }
    caption + "."
}

fn chart(title: &str, y: &str, caption: &str) -> Chart {
    Chart::new(title, "step", y, caption)
}

fn averaged(steps: &[&StepRecord], name: &str, value: &dyn Fn(&StepRecord) -> f64) -> Curve {
    let points: Vec<(f64, f64)> = steps.iter().map(|step| (step.step as f64, value(step))).collect();
    Curve::averaged(name, &points)
}
