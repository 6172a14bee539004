//! The report of a training.

use srflow_avatar::train::{
    IterationsRecord, LogRecord, RunOutcome, ScoredSplit, ScoresRecord, Trainer, ViewScore,
};
use srflow_files::settings_text;
use srflow_report::html::{
    Axis, Chart, Curve, Figure, Page, Picture, Section, compare, curves, score_table, settings_facts,
    side_by_side, tiles,
};
use srflow_report::shrink_image;

use super::super::scores::{SCORE_DEFINITIONS, camera_table, split_table, split_words};
use crate::machine;

/// Most width of a picture, pixels.
const WIDTH: usize = 550;

/// The page.
///
/// # Errors
/// When a picture cannot be read, rendered or encoded.
pub fn page(outcome: &RunOutcome, log: &[LogRecord]) -> anyhow::Result<Page> {
    let splits = outcome.scores.as_ref().map_or(&[][..], |scores| &scores.splits);
    let lines: Vec<&IterationsRecord> = log
        .iter()
        .filter_map(|record| if let LogRecord::Iterations(line) = record { Some(line) } else { None })
        .collect();
    let scored: Vec<&ScoresRecord> = log
        .iter()
        .filter_map(|record| if let LogRecord::Scores(scores) = record { Some(scores) } else { None })
        .collect();
    let mut sections = Vec::new();
    for split in splits {
        sections.push(held_out(outcome, split)?);
    }
    sections.push(training(&lines, &scored, splits, outcome.config.iterations));
    sections.push(Section::new(
        "Configuration",
        "All settings of the run, as in config.toml next to this page.",
        vec![settings_facts(&settings_text(&outcome.config))],
    ));
    let trainer = &outcome.trainer;
    let capture = trainer.capture();
    let mut opening = vec![tiles(&numbers(trainer, splits, &lines))];
    if !splits.is_empty() {
        opening.push(score_table(&split_table(splits.iter().map(|split| &split.scores)), SCORE_DEFINITIONS));
    }
    Ok(Page {
        title: "Training an avatar".to_owned(),
        kicker: "srflow avatar train".to_owned(),
        lead: format!(
            "Gaussians on the head model {}, learned from {} timesteps by {} cameras: {}.",
            trainer.avatar().model().name,
            capture.timesteps().len(),
            capture.camera_indices().len(),
            capture.dir().display()
        ),
        opening,
        sections,
        colophon: format!("Made by srflow {} on {}.", env!("CARGO_PKG_VERSION"), machine::describe()),
    })
}

fn numbers(trainer: &Trainer, splits: &[ScoredSplit], lines: &[&IterationsRecord]) -> Vec<(String, String)> {
    let seconds: f64 = lines.iter().map(|line| line.seconds).sum();
    let rate = trainer.iteration() as f64 / seconds.max(f64::MIN_POSITIVE);
    let mut numbers = vec![
        (trainer.iteration().to_string(), "iterations".to_owned()),
        (format!("{rate:.1}"), "iterations per second".to_owned()),
        (trainer.avatar().bound().len().to_string(), "Gaussians".to_owned()),
    ];
    numbers.extend(splits.iter().map(|ScoredSplit { scores, .. }| {
        (format!("{:.2} dB", scores.mean.psnr), format!("PSNR, {}", split_words(scores.split)))
    }));
    numbers
}

/// The pictures of a split with the lowest, the median and the highest ratio, each under a divider with its rendering.
fn held_out(outcome: &RunOutcome, split: &ScoredSplit) -> anyhow::Result<Section> {
    let mut views: Vec<&ViewScore> = split.views.iter().collect();
    views.sort_by(|a, b| a.score.psnr.total_cmp(&b.score.psnr));
    let mut places = vec![("worst", 0), ("median", views.len() / 2), ("best", views.len().saturating_sub(1))];
    places.dedup_by_key(|(_, place)| *place);
    let sliders = places.iter().filter_map(|(word, place)| Some((word, views.get(*place)?)));
    let sliders = sliders.map(|(word, view)| slider(outcome, word, view)).collect::<Result<_, _>>()?;
    let mut figures = vec![side_by_side(sliders, 260)];
    if split.scores.cameras.len() > 1 {
        figures.push(score_table(&camera_table(&split.scores), ""));
    }
    let words = split_words(split.scores.split);
    Ok(Section::new(
        format!("{}{}", words[..1].to_uppercase(), &words[1..]),
        format!(
            "Of {} pictures that were not trained on, those with the lowest, the median and the highest PSNR. Drag the dividers, or \
             move them with the arrow keys: truth on the left, rendering on the right.",
            split.scores.pictures
        ),
        figures,
    ))
}

fn slider(outcome: &RunOutcome, word: &str, scored: &ViewScore) -> anyhow::Result<Figure> {
    let of_score = |view: &&srflow_avatar::capture::CaptureView| {
        (view.timestep, view.camera_index) == (scored.timestep, scored.camera)
    };
    let view = outcome.trainer.capture().views().iter().find(of_score);
    let view = view.ok_or_else(|| anyhow::anyhow!("{}: not in the capture", scored.image.display()))?;
    let [truth, rendered] = outcome.trainer.truth_and_rendering(view)?;
    let name = format!("timestep {}, camera {}", scored.timestep, scored.camera);
    let [truth, rendered] = [(&truth, "picture"), (&rendered, "rendering")]
        .map(|(image, what)| Picture::jpeg(&shrink_image(image, WIDTH), &format!("{what} of {name}")));
    let caption = format!(
        "{word}: {name}, PSNR {:.2} dB (mean of channels {:.2} dB), SSIM {:.4}",
        scored.score.psnr, scored.score.psnr_channels, scored.score.ssim
    );
    Ok(compare((&truth?, "truth"), (&rendered?, "rendering"), &caption))
}

fn training(
    lines: &[&IterationsRecord],
    scored: &[&ScoresRecord],
    splits: &[ScoredSplit],
    iterations: u64,
) -> Section {
    let curve = |name: &str, value: fn(&IterationsRecord) -> f64| {
        let points: Vec<(f64, f64)> = lines.iter().map(|line| (line.iteration as f64, value(line))).collect();
        Curve::averaged(name, &points)
    };
    let chart = |title: &str, y: &str, caption: &str| Chart::new(title, "iteration", y, caption);
    let losses = [
        curve("total", |line| line.loss),
        curve("L1", |line| line.l1),
        curve("1 - SSIM", |line| 1.0 - line.ssim),
        curve("positions", |line| line.position),
        curve("scales", |line| line.scale),
    ];
    let loss_caption = "Of the pictures for training, before each step: the total, with L1 and 1 - SSIM before they are weighted, and \
                        what keeps Gaussians near their triangles and small.";
    let count = [curve("Gaussians", |line| line.gaussians as f64)];
    let count_caption = "Gaussians are cloned, split and removed at intervals.";
    let mut figures = vec![
        curves(&losses, Axis::Logarithmic, false, &chart("Loss", "loss", loss_caption)),
        curves(&count, Axis::Linear, false, &chart("Gaussians", "number", count_caption)),
    ];
    // The last point is the score at the end, which is not in the log.
    let name = scored.first().map(|scores| scores.split.clone());
    let last = splits.iter().find(|split| Some(split.scores.split.name()) == name.as_deref());
    let ratios = [
        (
            "whole picture",
            ratio_points(scored, |scores| scores.psnr, last.map(|of| of.scores.mean.psnr), iterations),
        ),
        (
            "mean of channels",
            ratio_points(
                scored,
                |scores| scores.psnr_channels,
                last.map(|of| of.scores.mean.psnr_channels),
                iterations,
            ),
        ),
    ];
    if let Some(name) = name {
        let ratios = ratios.map(|(name, points)| Curve { name: name.to_owned(), points, baseline: false });
        let caption = format!("Of the held-out pictures ({name}), ten times in a run.");
        figures.push(curves(&ratios, Axis::Linear, true, &chart("Held-out pictures", "PSNR, dB", &caption)));
    }
    Section::new("Training", "Each point of a loss is a mean over the iterations around it.", figures)
}

fn ratio_points(
    scored: &[&ScoresRecord],
    ratio: fn(&ScoresRecord) -> Option<f64>,
    last: Option<f64>,
    iterations: u64,
) -> Vec<(f64, f64)> {
    let points = scored.iter().filter_map(|scores| Some((scores.iteration as f64, ratio(scores)?)));
    points.chain(last.map(|last| (iterations as f64, last))).collect()
}
