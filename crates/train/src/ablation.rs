//! The paper's ablation (section V-B): the same training with each regularizer alone, with several seeds.
//!
//! Every row and seed of the table is a run in its own folder, `LOSS-seed-N`. Finished runs are not repeated, interrupted ones
//! resume, and the table is built from their files.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use srflow_eval::{Column, Row, SCORES, ScoreColumn, Table, score_columns};
use srflow_field::{FileKind, Metrics, parse_error_in_words, read_text, write_file};
use srflow_read::flow::FlowDataset;

use crate::checkpoint::Checkpoints;
use crate::config::Config;
use crate::loss::{MaskReading, REGULARIZERS, Regularizer};
use crate::run::{Event, RunMode, TrainError, train};
use crate::training_set::OpenMade;
use crate::validation::score_weights;

/// A row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Variant {
    /// Name in folders and on the command line.
    pub name: String,
    /// Name in tables.
    pub title: String,
    /// Whether it is trained; if not, the initial weights of the other rows are scored.
    pub trained: bool,
    regularizer: Option<&'static Regularizer>,
    m_total: MaskReading,
}

/// Every row that can be run: the paper's, and each regularizer that reads `M_total` with the literal reading of it.
pub fn variants() -> Vec<Variant> {
    let plain = |name: &str, title: &str, trained| Variant {
        name: name.to_owned(),
        title: title.to_owned(),
        trained,
        regularizer: None,
        m_total: MaskReading::Interior,
    };
    let with = |regularizer: &'static Regularizer| Variant {
        regularizer: Some(regularizer),
        ..plain(regularizer.name, regularizer.title, true)
    };
    let literal = |regularizer: &'static Regularizer| Variant {
        name: format!("{}-literal", regularizer.name),
        title: format!("{}, literal mask", regularizer.title),
        m_total: MaskReading::Literal,
        ..with(regularizer)
    };
    let mut rows = vec![plain("start", "before training", false), plain("none", "no regularizer", true)];
    rows.extend(REGULARIZERS.iter().map(with));
    rows.extend(REGULARIZERS.iter().filter(|regularizer| regularizer.reads_total_mask()).map(literal));
    rows
}

impl Variant {
    /// The configuration of this row: `base` with another loss and seed.
    pub fn config(&self, base: &Config, seed: u64) -> Config {
        let mut config = base.clone();
        config.training.seed = seed;
        for regularizer in REGULARIZERS {
            let weight = if Some(regularizer) == self.regularizer { regularizer.paper_weight } else { 0.0 };
            config.loss = config.loss.with(regularizer, weight);
        }
        config.loss.m_total = self.m_total;
        config
    }
}

/// The scores of one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Name of the [`Variant`].
    pub variant: String,
    pub seed: u64,
    /// Training steps; 0 for a row that is not trained.
    pub steps: u64,
    /// Scores of the last weights on the test set, over all pixels.
    pub scores: Metrics,
    /// Mean end-point error of zero flow on the test set, in pixels.
    pub zero_epe: f64,
}

/// Progress of [`ablate`].
#[derive(Debug)]
pub enum AblationEvent<'a> {
    /// A run starts or resumes, or is already finished.
    Cell {
        variant: &'a Variant,
        seed: u64,
        /// Whether it is already finished.
        done: bool,
    },
    Training(Event<'a>),
}

/// The runs of an ablation.
#[derive(Debug, Clone, PartialEq)]
pub struct AblationSettings {
    /// The configuration of all runs, apart from loss and seed.
    pub base: Config,
    pub variants: Vec<Variant>,
    pub seeds: Vec<u64>,
}

impl AblationSettings {
    /// Every row with every seed, in the order in which they run. A row that is not trained occurs once, as it does not depend
    /// on the seed.
    pub fn runs(&self) -> Vec<(Variant, u64)> {
        let all = self
            .seeds
            .iter()
            .flat_map(|&seed| self.variants.iter().map(move |variant| (variant.clone(), seed)));
        all.filter(|(variant, seed)| variant.trained || Some(seed) == self.seeds.first()).collect()
    }
}

/// Errors that end an ablation.
#[derive(Debug, thiserror::Error)]
pub enum AblationError {
    #[error("{run}: {error}")]
    Run { run: String, error: Box<TrainError> },
    #[error(
        "{}: this folder contains a run with other settings; choose another --out, or delete the folder", .run.display()
    )]
    OtherSettings { run: PathBuf },
    #[error("{}: {reason}; delete the file to score the run again", .path.display())]
    Result { path: PathBuf, reason: String },
}

/// Name of the file with the scores of a finished run.
const RESULT: &str = "test.json";

/// Trains every row with every seed, each in a subfolder of `out`, and scores its last weights on `test`. Finished runs are not
/// repeated. A row that is not [`trained`](Variant::trained) needs `network.weights` in the configuration.
///
/// # Errors
/// Stops at the first run that fails; finished runs are kept.
pub fn ablate(
    settings: &AblationSettings,
    test: &FlowDataset,
    open_made: &OpenMade,
    devices: &[Device],
    out: &Path,
    on_event: &mut dyn FnMut(AblationEvent<'_>),
) -> Result<Vec<Cell>, AblationError> {
    let mut cells = Vec::new();
    for (variant, seed) in settings.runs() {
        let run = out.join(format!("{}-seed-{seed}", variant.name));
        let config = variant.config(&settings.base, seed);
        let failed =
            |error: TrainError| AblationError::Run { run: run.display().to_string(), error: Box::new(error) };
        let score = |weights: &Path, steps: u64| -> Result<Cell, AblationError> {
            let scores = score_weights(&config, &devices[0], weights, test).map_err(failed)?;
            let variant = variant.name.clone();
            Ok(Cell { variant, seed, steps, scores: scores.whole, zero_epe: scores.zero_epe })
        };
        if !variant.trained {
            on_event(AblationEvent::Cell { variant: &variant, seed, done: false });
            cells.push(score(&config.network.weights, 0)?);
            continue;
        }
        let result = run.join(RESULT);
        let begun = !Checkpoints::of_run(&run).steps().map_err(|error| failed(error.into()))?.is_empty();
        if begun && crate::run::config_of_run(&run).map_err(failed)? != config {
            return Err(AblationError::OtherSettings { run });
        }
        let done = result.exists();
        on_event(AblationEvent::Cell { variant: &variant, seed, done });
        if !done {
            let mode = if begun { RunMode::Resume } else { RunMode::New };
            let outcome = train(&config, open_made, devices, &run, mode, None, &mut |event| {
                on_event(AblationEvent::Training(event));
            })
            .map_err(failed)?;
            let cell = score(&run.join("last.safetensors"), outcome.progress.step)?;
            let text = serde_json::to_string_pretty(&cell).expect("plain numbers and text") + "\n";
            write_file(&result, text).map_err(|error| failed(error.into()))?;
        }
        cells.push(read_cell(&result)?);
    }
    Ok(cells)
}

fn read_cell(path: &Path) -> Result<Cell, AblationError> {
    let wrong = |reason: String| AblationError::Result { path: path.to_owned(), reason };
    let text = read_text(path, FileKind::Json).map_err(|error| wrong(error.problem.to_string()))?;
    serde_json::from_str(&text).map_err(|error| wrong(parse_error_in_words(&error)))
}

/// The paper's Table V, as printed: SKFlow as published, retrained on SRFlow, and the four SRFlowNets.
const PAPER: [(&str, [f64; 6]); 6] = [
    ("SKFlow", [0.5361, 0.8452, 0.9678, 0.9927, 3.2159, 80.3533]),
    ("SKFlow+SRFlow", [0.3998, 0.8975, 0.9933, 0.9992, 0.6722, 83.8335]),
    ("SRFlowNet-TVR", [0.4056, 0.8977, 0.9924, 0.9988, 0.7622, 83.6409]),
    ("SRFlowNet-FDR", [0.3946, 0.8991, 0.9932, 0.9992, 0.6815, 84.0652]),
    ("SRFlowNet-MIGAR", [0.3955, 0.8987, 0.9942, 0.9993, 0.5791, 83.9568]),
    ("SRFlowNet-IGVAR", [0.4000, 0.8993, 0.9927, 0.9989, 0.7270, 83.8422]),
];

/// The scores of the runs as in the paper's Table V: one row per variant, means over the seeds.
pub fn table(cells: &[Cell], title: String) -> Table {
    Table { title, columns: score_columns(), rows: rows(cells, "", mean), ..Table::default() }
}

/// The sample standard deviation over the seeds (divided by `n - 1`), in the form of [`table`].
pub fn spread_table(cells: &[Cell], title: String) -> Table {
    let columns = score_columns().into_iter().map(|column| Column { better: None, ..column }).collect();
    Table { title, columns, rows: rows(cells, "± ", deviation), ..Table::default() }
}

/// The paper's Table V. It is kept apart from [`table`]: its data, image size and training length differ.
pub fn paper_table() -> Table {
    let row = |(name, values): (&str, [f64; 6])| Row {
        name: name.to_owned(),
        values: values.map(Some).to_vec(),
        baseline: false,
    };
    Table {
        title: "The paper's Table V (arXiv 2601.06479), as printed".to_owned(),
        columns: score_columns(),
        rows: PAPER.map(row).to_vec(),
        ..Table::default()
    }
}

fn rows(cells: &[Cell], prefix: &str, over_seeds: impl Fn(&[f64]) -> Option<f64>) -> Vec<Row> {
    variants()
        .iter()
        .map(|variant| {
            (variant, cells.iter().filter(|cell| cell.variant == variant.name).collect::<Vec<&Cell>>())
        })
        .filter(|(_, cells)| !cells.is_empty())
        .map(|(variant, cells)| {
            let value = |(.., value): &ScoreColumn| {
                over_seeds(&cells.iter().map(|cell| value(&cell.scores)).collect::<Vec<f64>>())
            };
            let name = format!("{prefix}{}", variant.title);
            Row { name, values: SCORES.iter().map(value).collect(), baseline: false }
        })
        .collect()
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values).filter(|_| values.len() > 1)?;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(variant: &str, seed: u64, epe: f64) -> Cell {
        let scores = Metrics { epe, px1: 0.5, px3: 0.9, px5: 1.0, f1_all: 2.0, wauc: 80.0, valid_pixels: 9 };
        Cell { variant: variant.to_owned(), seed, steps: 4, scores, zero_epe: 2.0 }
    }

    #[test]
    fn tables_show_mean_and_deviation_over_the_seeds() {
        let cells = [cell("none", 1, 1.0), cell("fdr", 1, 0.5), cell("none", 2, 2.0), cell("none", 3, 3.0)];
        let ours = table(&cells, "ours".to_owned());
        let names: Vec<&str> = ours.rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, ["no regularizer", "FDR"]);
        assert_eq!(ours.rows[0].value(0), Some(2.0));
        let spread = spread_table(&cells, "spread".to_owned());
        assert_eq!(spread.rows[0].value(0), Some(1.0));
        assert_eq!(spread.rows[1].value(0), None); // one seed has no spread
    }

    #[test]
    fn variants_differ_only_in_loss_and_seed() {
        let base = Config::default();
        for variant in variants() {
            let config = variant.config(&base, 7);
            let mut back = config.clone();
            back.training.seed = base.training.seed;
            back.loss = base.loss.clone();
            assert_eq!(back, base);
            let on: Vec<_> = REGULARIZERS.iter().filter(|entry| config.loss.weight(entry) > 0.0).collect();
            assert_eq!(on, variant.regularizer.into_iter().collect::<Vec<_>>());
        }
    }
}
