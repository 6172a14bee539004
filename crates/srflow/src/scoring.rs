//! An evaluation that reports its progress.

use std::path::Path;

use srflow_data::flow::FlowDataset;
use srflow_eval::{Evaluation, Event, Method, ScoredPair, Settings, evaluate};
use srflow_files::{create_folder, write_flow};

use crate::Watch;

/// Scores `methods` over `dataset`. `on_pair` sees every pair that was
/// scored, and whether it is one of `shown` that are spread evenly over them, for pictures.
///
/// # Errors
/// Those of [`evaluate`], or the first of `on_pair`.
pub fn score(
    dataset: &FlowDataset,
    methods: &[Method<'_>],
    settings: Settings,
    shown: usize,
    watch: &Watch,
    on_pair: &mut dyn FnMut(&ScoredPair, bool) -> anyhow::Result<()>,
) -> anyhow::Result<Evaluation> {
    let scored = watch.count("pairs", 0);
    let mut problem: Option<anyhow::Error> = None;
    let mut every = None;
    let result = evaluate(dataset, methods, settings, &mut |event| match event {
        Event::Started { pairs } => {
            scored.set_total(pairs as u64);
            every = shown_every(pairs, shown);
        }
        Event::Estimating { method, pair } => scored.message(format!("{method} on {pair}")),
        Event::Scored(pair) => {
            scored.inc();
            if problem.is_none() {
                problem = on_pair(pair, is_shown(pair.index, every)).err();
            }
        }
        Event::Kept => scored.inc(),
        Event::LeftOut(failure) => {
            scored.inc();
            log::info!("left out: {}: {}", failure.pair, failure.reason);
        }
    });
    let evaluation = result?;
    problem.map_or(Ok(evaluation), Err)
}

/// The distance between two pairs that are shown; `None` if none is.
pub fn shown_every(pairs: usize, shown: usize) -> Option<usize> {
    (shown > 0).then(|| pairs.div_ceil(shown).max(1))
}

/// Whether the pair of this index is shown.
pub fn is_shown(index: usize, every: Option<usize>) -> bool {
    every.is_some_and(|every| index % every == every / 2)
}

/// The folder name of a method: its name, without characters that some system does not allow.
pub fn folder_name(method: &str) -> String {
    let allowed = |c: char| !c.is_control() && !r#"/\:*?"<>|"#.contains(c);
    let name: String = method.chars().map(|c| if allowed(c) { c } else { '_' }).collect();
    if name.chars().all(|c| c == '.') { "_".to_owned() } else { name }
}

/// Writes the flow of each method into a folder of its name in `dir`, as [`srflow_eval::FlowFiles`] finds it.
pub fn save_flows(pair: &ScoredPair, dir: &Path) -> anyhow::Result<()> {
    for estimate in pair.estimates.iter().filter(|estimate| !estimate.baseline) {
        let file = dir.join(folder_name(&estimate.method)).join(format!("{}.flo", pair.name));
        file.parent().map_or(Ok(()), create_folder)?;
        write_flow(&file, &estimate.flow)?;
    }
    Ok(())
}
