//! An evaluation with a progress bar and pictures of some of its pairs.

use std::path::Path;

use srflow_eval::report::{Figure, pair_figures};
use srflow_eval::{Evaluation, Event, Method, ScoredPair, Settings, evaluate};
use srflow_field::{create_folder, write_flow};
use srflow_read::flow::FlowDataset;

use crate::progress::bar;

/// The pairs that become pictures.
#[derive(Debug, Clone, Copy)]
pub struct Pictures {
    /// Number of pairs, spread evenly over the scored ones.
    pub pairs: usize,
    /// Maximum width of each picture in pixels.
    pub width: usize,
}

/// Scores `methods` over `dataset`, with a bar on standard error if that is a terminal. With `save`, the flow of each method
/// is written into a subfolder with its name, in the layout of [`srflow_eval::FlowFiles`].
///
/// # Errors
/// Those of [`evaluate`], and when a picture cannot be encoded or a flow cannot be written.
pub fn score(
    dataset: &FlowDataset,
    methods: &[Method<'_>],
    settings: Settings,
    pictures: Pictures,
    save: Option<&Path>,
) -> anyhow::Result<(Evaluation, Vec<Figure>)> {
    let bar = bar(0, "{bar:30} {pos}/{len} pairs  {elapsed} elapsed, {eta} to go  {msg}");
    let mut figures = Vec::new();
    let mut problem: Option<anyhow::Error> = None;
    let mut shown_every = None;
    let result = evaluate(dataset, methods, settings, &mut |event| match event {
        Event::Started { pairs } => {
            bar.set_length(pairs as u64);
            shown_every = (pictures.pairs > 0).then(|| pairs.div_ceil(pictures.pairs).max(1));
        }
        Event::Estimating { method, pair } => bar.set_message(format!("{method} on {pair}")),
        Event::Scored(pair) => {
            bar.inc(1);
            if let (None, Some(dir)) = (&problem, save) {
                problem = save_flows(pair, dir).err();
            }
            if problem.is_none() && shown_every.is_some_and(|every| pair.index % every == every / 2) {
                match pair_figures(pair, pictures.width, "") {
                    Ok(more) => figures.extend(more),
                    Err(error) => problem = Some(error.into()),
                }
            }
        }
        Event::LeftOut(failure) => {
            bar.inc(1);
            bar.suspend(|| note!("left out: {}: {}", failure.pair, failure.reason));
        }
    });
    bar.finish_and_clear();
    let evaluation = result?;
    match problem {
        Some(error) => Err(error),
        None => Ok((evaluation, figures)),
    }
}

/// The folder name of a method: its name, without characters that some system does not allow.
pub fn folder_name(method: &str) -> String {
    let allowed = |c: char| !c.is_control() && !r#"/\:*?"<>|"#.contains(c);
    let name: String = method.chars().map(|c| if allowed(c) { c } else { '_' }).collect();
    if name.chars().all(|c| c == '.') { "_".to_owned() } else { name }
}

fn save_flows(pair: &ScoredPair, dir: &Path) -> anyhow::Result<()> {
    for estimate in pair.estimates.iter().filter(|estimate| !estimate.baseline) {
        let file = dir.join(folder_name(&estimate.method)).join(format!("{}.flo", pair.name));
        file.parent().map_or(Ok(()), create_folder)?;
        write_flow(&file, &estimate.flow)?;
    }
    Ok(())
}
