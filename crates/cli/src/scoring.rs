//! An evaluation with a progress bar and pictures of a few of its pairs.

use indicatif::{ProgressBar, ProgressStyle};
use srflow_eval::report::{Figure, pair_figures};
use srflow_eval::{Evaluation, Event, Settings, evaluate};
use srflow_field::FlowEstimator;
use srflow_read::flow::FlowDataset;

/// Which pairs become pictures.
#[derive(Debug, Clone, Copy)]
pub struct Pictures {
    /// How many pairs, spread evenly over those that are scored.
    pub pairs: usize,
    /// Greatest width of each picture in pixels.
    pub width: usize,
}

/// Scores `estimators` over `dataset`, with a bar on standard error where that is a terminal.
///
/// # Errors
/// Those of [`evaluate`], or when a picture cannot be encoded.
pub fn score(
    dataset: &FlowDataset,
    estimators: &[Box<dyn FlowEstimator>],
    settings: Settings,
    pictures: Pictures,
) -> anyhow::Result<(Evaluation, Vec<Figure>)> {
    let estimators: Vec<&dyn FlowEstimator> = estimators.iter().map(AsRef::as_ref).collect();
    let bar = ProgressBar::new(0).with_style(ProgressStyle::with_template(
        "{bar:30} {pos}/{len} pairs  {elapsed} elapsed, {eta} to go  {msg}",
    )?);
    let mut figures = Vec::new();
    let mut problem = None;
    let mut shown_every = None;
    let result = evaluate(dataset, &estimators, settings, &mut |event| match event {
        Event::Started { pairs } => {
            bar.set_length(pairs as u64);
            shown_every = (pictures.pairs > 0).then(|| pairs.div_ceil(pictures.pairs).max(1));
        }
        Event::Estimating { method, pair } => bar.set_message(format!("{method} on {pair}")),
        Event::Scored(pair) => {
            bar.inc(1);
            if problem.is_none() && shown_every.is_some_and(|every| pair.index % every == every / 2) {
                match pair_figures(pair, pictures.width, "") {
                    Ok(more) => figures.extend(more),
                    Err(error) => problem = Some(error),
                }
            }
        }
        Event::LeftOut(failure) => {
            bar.inc(1);
            bar.suspend(|| eprintln!("left out: {}: {}", failure.pair, failure.reason));
        }
    });
    bar.finish_and_clear();
    let evaluation = result?;
    match problem {
        Some(error) => Err(error.into()),
        None => Ok((evaluation, figures)),
    }
}
