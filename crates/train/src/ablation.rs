//! The paper's ablation (section V-B): the same training with each regularizer alone, with several seeds.
//!
//! Every row and seed of the table is a run in its own folder, `LOSS-seed-N`. Finished runs are not repeated, interrupted ones
//! resume, and the table is built from their files.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use srflow_core::Metrics;
use srflow_data::flow::FlowDataset;
use srflow_eval::{
    Region, SCORES, ScoreColumn, dataset_title, improvement_columns, improvement_percent, score_columns,
};
use srflow_files::{FileKind, RunMode, parse_error_in_words, read_text, write_file};
use srflow_nets::load_network;
use srflow_report::{Column, Row, Table};

use crate::checkpoint::Checkpoints;
use crate::config::{Config, Source};
use crate::error::TrainError;
use crate::loss::{MaskReading, REGULARIZERS, Regularizer};
use crate::made::OpenMade;
use crate::ranks::Alone;
use crate::run::{Event, Training};
use crate::training_log::ValidationRecord;
use crate::validation::Validation;

/// A row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct Variant {
    /// Name in folders and on the command line.
    pub name: String,
    /// Name in tables.
    pub title: String,
    pub data: VariantData,
    regularizer: Option<&'static Regularizer>,
    m_total: MaskReading,
}

/// What a row is trained on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VariantData {
    /// Nothing: the initial weights of the other rows are scored.
    None,
    /// [`AblationSettings::control`].
    Control,
    /// The training data of the configuration.
    Own,
}

/// Every row that can be run: the paper's, a control that trains as long on other data, and each regularizer that reads `M_total`
/// with the literal reading of it.
pub fn variants() -> Vec<Variant> {
    let plain = |name: &str, title: &str, data| Variant {
        name: name.to_owned(),
        title: title.to_owned(),
        data,
        regularizer: None,
        m_total: MaskReading::Interior,
    };
    let with = |regularizer: &'static Regularizer| Variant {
        regularizer: Some(regularizer),
        ..plain(regularizer.name, regularizer.title, VariantData::Own)
    };
    let literal = |regularizer: &'static Regularizer| Variant {
        name: format!("{}-literal", regularizer.name),
        title: format!("{}, literal mask", regularizer.title),
        m_total: MaskReading::Literal,
        ..with(regularizer)
    };
    let mut rows = vec![
        plain(START, "before training", VariantData::None),
        plain("control", "trained on the control data", VariantData::Control),
        plain(PLAIN, "no regularizer", VariantData::Own),
    ];
    rows.extend(REGULARIZERS.iter().map(with));
    rows.extend(REGULARIZERS.iter().filter(|regularizer| regularizer.reads_total_mask()).map(literal));
    rows
}

/// The row that others are improvements on, and the one that regularizers are held against.
const START: &str = "start";
const PLAIN: &str = "none";

/// The scores of one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Name of the [`Variant`].
    pub variant: String,
    pub seed: u64,
    /// Training steps; 0 for a row that is not trained.
    pub steps: u64,
    /// Scores of the last weights on each test set.
    pub tests: Vec<TestScores>,
}

/// The scores of one run on one dataset: means over the pairs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TestScores {
    /// Kind and split.
    pub dataset: String,
    pub folder: PathBuf,
    pub pairs: usize,
    /// Over all pixels with a known flow.
    pub whole: Metrics,
    /// Over the pixels of the head, if the dataset has masks.
    pub head: Option<Metrics>,
    /// Mean end-point error of zero flow, in pixels.
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
    /// Training data of the rows with [`VariantData::Control`].
    pub control: Vec<Source>,
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
        let once = |(variant, seed): &(Variant, u64)| {
            variant.data != VariantData::None || Some(seed) == self.seeds.first()
        };
        all.filter(once).collect()
    }

    /// The configuration of a run: the base with another loss and seed, and with other data in the control.
    fn config(&self, variant: &Variant, seed: u64) -> Config {
        let mut config = self.base.clone();
        config.training.seed = seed;
        if variant.data == VariantData::Control {
            config.data.train.clone_from(&self.control);
        }
        for regularizer in REGULARIZERS {
            let weight =
                if Some(regularizer) == variant.regularizer { regularizer.paper_weight } else { 0.0 };
            config.loss = config.loss.with(regularizer, weight);
        }
        config.loss.m_total = variant.m_total;
        config
    }
}

#[derive(Debug, thiserror::Error)]
pub enum AblationError {
    #[error("{run}: {error}")]
    Run { run: String, error: Box<TrainError> },
    #[error(
        "{}: this folder contains a run with other settings; choose another `out`, or delete the folder", .run.display()
    )]
    OtherSettings { run: PathBuf },
    #[error("{}: {reason}; delete the file to score the run again", .path.display())]
    Result { path: PathBuf, reason: String },
}

/// Name of the file with the scores of a finished run.
const RESULT: &str = "test.json";

/// The result of [`ablate`].
#[derive(Debug, Clone, PartialEq)]
pub struct Ablated {
    /// The scores of each finished run.
    pub cells: Vec<Cell>,
    /// Whether it was stopped before the last run.
    pub stopped: bool,
}

/// Trains every row with every seed, each in a subfolder of `out`, and scores its last weights on each of `tests`. Finished runs are
/// not repeated, and are only scored again on other datasets. A row that is not trained needs `network.weights` in the
/// configuration. When `stop` asks it to, it stops after a step, with a checkpoint; the same call continues.
///
/// # Errors
/// Stops at the first run that fails; finished runs are kept.
pub fn ablate(
    settings: &AblationSettings,
    tests: &[FlowDataset],
    open_made: &OpenMade,
    devices: &[Device],
    out: &Path,
    stop: &dyn Fn() -> bool,
    on_event: &mut dyn FnMut(AblationEvent<'_>),
) -> Result<Ablated, AblationError> {
    let mut cells = Vec::new();
    for (variant, seed) in settings.runs() {
        if stop() {
            return Ok(Ablated { cells, stopped: true });
        }
        let run = out.join(format!("{}-seed-{seed}", variant.name));
        let config = settings.config(&variant, seed);
        let failed =
            |error: TrainError| AblationError::Run { run: run.display().to_string(), error: Box::new(error) };
        let score = |weights: &Path, steps: u64| -> Result<Cell, AblationError> {
            let tests = tests.iter().map(|test| {
                let scores = score_weights(&config, &devices[0], weights, test).map_err(failed)?;
                Ok(TestScores {
                    dataset: scores.dataset,
                    folder: test.dir().to_owned(),
                    pairs: scores.pairs,
                    whole: scores.whole,
                    head: scores.head,
                    zero_epe: scores.zero_epe,
                })
            });
            let tests = tests.collect::<Result<_, AblationError>>()?;
            Ok(Cell { variant: variant.name.clone(), seed, steps, tests })
        };
        if variant.data == VariantData::None {
            on_event(AblationEvent::Cell { variant: &variant, seed, done: false });
            cells.push(score(&config.network.weights, 0)?);
            continue;
        }
        let result = run.join(RESULT);
        let begun = !Checkpoints::of_run(&run).steps().map_err(|error| failed(error.into()))?.is_empty();
        if begun && crate::run::config_of_run(&run).map_err(failed)? != config {
            return Err(AblationError::OtherSettings { run });
        }
        let before = if result.exists() { Some(read_cell(&result)?) } else { None };
        on_event(AblationEvent::Cell { variant: &variant, seed, done: before.is_some() });
        let steps = match &before {
            Some(cell) => cell.steps,
            None => {
                let mode = if begun { RunMode::Resume } else { RunMode::New };
                let training =
                    Training { config: &config, open_made, devices, run: &run, mode, communicator: &Alone };
                let outcome = training
                    .until(&|_| stop(), &mut |event| on_event(AblationEvent::Training(event)))
                    .map_err(failed)?;
                if outcome.stopped {
                    return Ok(Ablated { cells, stopped: true });
                }
                outcome.progress.step
            }
        };
        cells.push(match before.filter(|cell| cell.is_of(tests)) {
            Some(cell) => cell,
            None => {
                let cell = score(&run.join("last.safetensors"), steps)?;
                let text = serde_json::to_string_pretty(&cell).expect("plain numbers and text") + "\n";
                write_file(&result, text).map_err(|error| failed(error.into()))?;
                read_cell(&result)?
            }
        });
    }
    Ok(Ablated { cells, stopped: false })
}

impl Cell {
    fn is_of(&self, tests: &[FlowDataset]) -> bool {
        let same = |(scores, test): (&TestScores, &FlowDataset)| {
            scores.folder == test.dir() && scores.dataset == dataset_title(test.name(), test.split())
        };
        self.tests.len() == tests.len() && self.tests.iter().zip(tests).all(same)
    }
}

fn read_cell(path: &Path) -> Result<Cell, AblationError> {
    let wrong = |reason: String| AblationError::Result { path: path.to_owned(), reason };
    let text = read_text(path, FileKind::Json).map_err(|error| wrong(error.problem.to_string()))?;
    serde_json::from_str(&text).map_err(|error| wrong(parse_error_in_words(&error)))
}

/// The paper's Table V, as printed: SKFlow as published, retrained on SRFlow, and the four SRFlowNets.
const PAPER_TABLE_V: [(&str, [f64; 6]); 6] = [
    ("SKFlow", [0.5361, 0.8452, 0.9678, 0.9927, 3.2159, 80.3533]),
    ("SKFlow+SRFlow", [0.3998, 0.8975, 0.9933, 0.9992, 0.6722, 83.8335]),
    ("SRFlowNet-TVR", [0.4056, 0.8977, 0.9924, 0.9988, 0.7622, 83.6409]),
    ("SRFlowNet-FDR", [0.3946, 0.8991, 0.9932, 0.9992, 0.6815, 84.0652]),
    ("SRFlowNet-MIGAR", [0.3955, 0.8987, 0.9942, 0.9993, 0.5791, 83.9568]),
    ("SRFlowNet-IGVAR", [0.4000, 0.8993, 0.9927, 0.9989, 0.7270, 83.8422]),
];

/// The paper's Table III, as printed: by how many percent training on SRFlow improved each score.
const PAPER_TABLE_III: [(&str, [f64; 6]); 4] = [
    ("SKFlow+SRFlow", [25.42, 6.19, 2.63, 0.65, 79.10, 4.33]),
    ("RPKNet+SRFlow", [8.99, 2.11, 1.32, 0.37, 41.58, 0.68]),
    ("MemFlow+SRFlow", [41.88, 9.62, 2.74, 0.66, 88.35, 8.18]),
    ("DPFlow+SRFlow", [36.02, 8.93, 2.73, 0.63, 86.99, 5.48]),
];

/// The paper's tables, which are kept apart from ours: their data, image size and training length differ.
pub fn paper_tables() -> [Table; 2] {
    let rows = |rows: &[(&str, [f64; 6])]| {
        let row = |(name, values): &(&str, [f64; 6])| Row {
            name: (*name).to_owned(),
            values: values.map(Some).to_vec(),
            baseline: false,
        };
        rows.iter().map(row).collect()
    };
    let table = |title: &str, columns, rows| Table {
        title: format!("The paper's Table {title} (arXiv 2601.06479), as printed"),
        columns,
        rows,
        ..Table::default()
    };
    [
        table("V", score_columns(), rows(&PAPER_TABLE_V)),
        table("III, improvement in percent", improvement_columns(), rows(&PAPER_TABLE_III)),
    ]
}

/// The tables of the scores on one test set, over all its pixels or inside its heads.
#[derive(Debug, Clone, PartialEq)]
pub struct TestTables {
    /// The test set and the pixels.
    pub title: String,
    /// Means over the seeds, as in the paper's Table V; standard deviations (divided by `n - 1`); improvement of the means on the row
    /// before training, as in the paper's Table III; and the difference of each regularizer from none with the same seed. The
    /// last two are missing where what they are held against was not run.
    pub tables: Vec<Table>,
}

/// The tables of each test set; inside its heads too, where it has masks.
pub fn test_tables(cells: &[Cell]) -> Vec<TestTables> {
    let Some(first) = cells.first() else { return Vec::new() };
    let mut all = Vec::new();
    for (test, scores) in first.tests.iter().enumerate() {
        for region in [Region::Whole, Region::Head] {
            let runs: Vec<Run<'_>> = cells.iter().filter_map(|cell| Run::new(cell, test, region)).collect();
            if runs.is_empty() {
                continue;
            }
            let title = format!("{}, {}", scores.dataset, region.words());
            let mut tables = vec![
                table(&runs, format!("{title}: mean over the seeds"), score_columns(), mean),
                table(&runs, format!("{title}: standard deviation over the seeds"), unranked(), deviation),
            ];
            tables.extend(improvements(&runs, &title));
            tables.extend(differences(&runs, &title));
            all.push(TestTables { title, tables });
        }
    }
    all
}

/// One run's scores on the pixels of a table.
struct Run<'a> {
    variant: &'a str,
    seed: u64,
    scores: &'a Metrics,
}

impl<'a> Run<'a> {
    fn new(cell: &'a Cell, test: usize, region: Region) -> Option<Self> {
        let scores = cell.tests.get(test)?;
        let scores = if region == Region::Head { scores.head.as_ref()? } else { &scores.whole };
        Some(Self { variant: &cell.variant, seed: cell.seed, scores })
    }
}

fn unranked() -> Vec<Column> {
    score_columns().into_iter().map(|column| Column { better: None, ..column }).collect()
}

/// The rows of the variants that were run, in the order of [`variants`].
fn rows(runs: &[Run<'_>], values: impl Fn(&[&Run<'_>]) -> Option<Vec<Option<f64>>>) -> Vec<Row> {
    let row = |variant: Variant| {
        let runs: Vec<&Run<'_>> = runs.iter().filter(|run| run.variant == variant.name).collect();
        let values = if runs.is_empty() { None } else { values(&runs) };
        Some(Row { name: variant.title, values: values?, baseline: false })
    };
    variants().into_iter().filter_map(row).collect()
}

fn table(
    runs: &[Run<'_>],
    title: String,
    columns: Vec<Column>,
    over_seeds: impl Fn(&[f64]) -> Option<f64>,
) -> Table {
    let values = |runs: &[&Run<'_>]| Some(scores_over(runs, &over_seeds));
    Table { title, columns, rows: rows(runs, values), ..Table::default() }
}

fn scores_over(runs: &[&Run<'_>], over_seeds: impl Fn(&[f64]) -> Option<f64>) -> Vec<Option<f64>> {
    let value = |(.., value): &ScoreColumn| {
        over_seeds(&runs.iter().map(|run| value(run.scores)).collect::<Vec<f64>>())
    };
    SCORES.iter().map(value).collect()
}

fn improvements(runs: &[Run<'_>], title: &str) -> Option<Table> {
    let start = runs.iter().find(|run| run.variant == START)?;
    let values = |runs: &[&Run<'_>]| {
        let improved = |(mean, (_, _, better, value)): (Option<f64>, &ScoreColumn)| {
            improvement_percent(*better, mean?, value(start.scores))
        };
        (runs[0].variant != START)
            .then(|| scores_over(runs, mean).into_iter().zip(&SCORES).map(improved).collect())
    };
    Some(Table {
        title: format!("{title}: improvement on the row before training, in percent"),
        columns: improvement_columns(),
        rows: rows(runs, values),
        ..Table::default()
    })
}

/// Held against the run with the same seed, what the seeds have in common cancels.
fn differences(runs: &[Run<'_>], title: &str) -> Option<Table> {
    let plain = |seed: u64| runs.iter().find(|run| run.variant == PLAIN && run.seed == seed);
    let held: Vec<&ScoreColumn> =
        SCORES.iter().filter(|(key, ..)| matches!(*key, "epe" | "f1_all")).collect();
    let values = |runs: &[&Run<'_>]| {
        let regularized =
            variants().iter().any(|row| row.name == runs[0].variant && row.regularizer.is_some());
        let of = |value: fn(&Metrics) -> f64| -> Vec<f64> {
            let pairs = runs.iter().filter_map(|run| Some((run, plain(run.seed)?)));
            pairs.map(|(run, plain)| value(run.scores) - value(plain.scores)).collect()
        };
        let columns = held.iter().flat_map(|(.., value)| [mean(&of(*value)), deviation(&of(*value))]);
        regularized.then(|| columns.collect())
    };
    let column = |(key, header, ..): &&ScoreColumn| {
        [
            Column::plain(&format!("{key}_difference"), header, 4),
            Column::plain(&format!("{key}_difference_deviation"), &format!("± {header}"), 4),
        ]
    };
    let rows = rows(runs, values);
    (!rows.is_empty() && runs.iter().any(|run| run.variant == PLAIN)).then(|| Table {
        title: format!(
            "{title}: difference from no regularizer with the same seed, mean and standard deviation"
        ),
        columns: held.iter().flat_map(column).collect(),
        rows,
        ..Table::default()
    })
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values).filter(|_| values.len() > 1)?;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

/// Scores the weights in a file on `dataset` with the validation settings of `config`.
fn score_weights(
    config: &Config,
    device: &Device,
    weights: &Path,
    dataset: &FlowDataset,
) -> Result<ValidationRecord, TrainError> {
    let validation = Validation::of(config, vec![dataset.clone()]);
    let network = config.network.with_settings(load_network(config.network.architecture, weights, device)?);
    let scores = validation.score(network, device)?;
    Ok(scores.into_iter().next().expect("one dataset was scored"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(variant: &str, seed: u64, epe: f64) -> Cell {
        let whole =
            Metrics { epe, px1: 0.5, px3: 0.9, px5: 1.0, f1_all: 2.0 * epe, wauc: 80.0, valid_pixels: 9 };
        let test = TestScores {
            dataset: "srflow, test split".to_owned(),
            folder: "faces".into(),
            pairs: 1,
            whole,
            head: None,
            zero_epe: 2.0,
        };
        Cell { variant: variant.to_owned(), seed, steps: 4, tests: vec![test] }
    }

    #[test]
    fn tables_show_mean_deviation_improvement_and_difference_over_the_seeds() {
        let cells = [
            cell("start", 1, 4.0),
            cell("none", 1, 1.0),
            cell("fdr", 1, 0.5),
            cell("none", 2, 2.0),
            cell("none", 3, 3.0),
            cell("fdr", 3, 3.5),
        ];
        let all = test_tables(&cells);
        let [TestTables { title, tables }] = &all[..] else { panic!("no masks, so one set of tables") };
        assert_eq!(title, "srflow, test split, all pixels");
        let [means, deviations, improvements, differences] = &tables[..] else { panic!("{tables:?}") };
        let names = |table: &Table| table.rows.iter().map(|row| row.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(means), ["before training", "no regularizer", "FDR"]);
        assert_eq!(means.rows[1].value(0), Some(2.0));
        assert_eq!(deviations.rows[0].value(0), None); // one run has no deviation
        assert_eq!(deviations.rows[1].value(0), Some(1.0));
        assert_eq!(names(improvements), ["no regularizer", "FDR"]);
        assert_eq!(improvements.rows[0].value(0), Some(50.0));
        assert_eq!(improvements.rows[0].value(1), Some(0.0)); // px1 is the same
        assert_eq!(names(differences), ["FDR"]);
        assert_eq!(differences.rows[0].value(0), Some(0.0)); // -0.5 and +0.5
        assert_eq!(differences.rows[0].value(2), Some(0.0));
        assert!((differences.rows[0].value(3).unwrap() - 2.0_f64.sqrt()).abs() < 1e-12);

        // Without what they are held against, the last two tables are missing.
        assert_eq!(test_tables(&cells[2..3])[0].tables.len(), 2);
    }

    #[test]
    fn variants_differ_only_in_loss_data_and_seed() {
        let control: Source = "chairs:shapes".parse().unwrap();
        let settings = AblationSettings {
            base: Config::default(),
            control: vec![control.clone()],
            variants: variants(),
            seeds: vec![7],
        };
        for variant in variants() {
            let config = settings.config(&variant, 7);
            let on: Vec<_> = REGULARIZERS.iter().filter(|entry| config.loss.weight(entry) > 0.0).collect();
            assert_eq!(on, variant.regularizer.into_iter().collect::<Vec<_>>());
            assert_eq!(config.data.train == [control.clone()], variant.name == "control");
            let mut back = config.clone();
            back.training.seed = settings.base.training.seed;
            back.loss = settings.base.loss.clone();
            back.data.train.clone_from(&settings.base.data.train);
            assert_eq!(back, settings.base);
        }
    }
}
