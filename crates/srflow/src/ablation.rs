//! The paper's ablation of losses.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow, bail};
use serde::{Deserialize, Serialize};
use srflow_data::flow::{FlowDataset, Split};
use srflow_files::{create_folder, write_file};
use srflow_ops::device;
use srflow_report::html::{Page, Section, score_table};
use srflow_report::{Table, TextStyle, joined, markdown_file};
use srflow_train::ablation::{
    Ablated, AblationEvent, AblationSettings, Cell, TestTables, Variant, VariantData, ablate, paper_tables,
    test_tables, variants,
};
use srflow_train::config::{Config, Source};

use crate::clap::Args;
use crate::made::open_made;
use crate::output::{ensure_folder, latex, write_page, write_tables};
use crate::train::{Overrides, Steps, default_device, find_weights};
use crate::{Job, Report, Watch, WhenStopped, machine};

/// Train with each loss of the paper and print its Table V
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Trains each row with each seed, from the same weights and on the same data, and scores the last weights on the test \
sets. Run the same command again to continue an interrupted run; finished runs are kept.

Examples:
The table at a size that two CPU cores manage
  srflow ablation --config cpu-small --data srflow:DIR --seeds 1,2,3 --out runs/ablation
Also what as much training on other data gives, all scored on both
  srflow ablation --config cpu-small --data srflow:DIR --control chairs:SHAPES --weights start.safetensors \
    --test srflow:DIR@test --test chairs:SHAPES@val --out runs/ablation")]
pub struct AblationJob {
    /// Preset or TOML file shared by all runs, except for its loss weights and seed [default: skflow]
    #[arg(long, value_name = "PRESET|FILE")]
    #[serde(default)]
    pub config: Option<PathBuf>,
    /// Folder for the runs and the table
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Rows to run
    #[arg(long, value_name = "ROW", value_delimiter = ',', help = rows_help())]
    #[serde(default)]
    pub rows: Vec<String>,
    /// Seeds for every row
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = default_seeds())]
    #[serde(default = "default_seeds")]
    pub seeds: Vec<u64>,
    /// Training data of the row `control`, KIND:DIR; several for a mix
    #[arg(long, value_name = "KIND:DIR")]
    #[serde(default)]
    pub control: Vec<Source>,
    /// Dataset to score on, KIND:DIR@SPLIT; several for tables of each [default: the test split of the first training dataset]
    #[arg(long, value_name = "KIND:DIR")]
    #[serde(default)]
    pub test: Vec<Source>,
    /// Device to train on; several devices share each batch
    #[arg(long, value_name = "DEVICE", default_values_t = default_device())]
    #[serde(default = "default_device")]
    pub device: Vec<String>,
    #[command(flatten)]
    #[serde(flatten)]
    pub overrides: Overrides,
}

fn default_seeds() -> Vec<u64> {
    vec![1, 2, 3]
}

fn rows_help() -> String {
    format!(
        "Rows to run: {} [default: all; start, which is not trained, only with --weights, control only with --control]",
        row_names()
    )
}

fn row_names() -> String {
    variants().into_iter().map(|row| row.name).collect::<Vec<_>>().join(", ")
}

impl AblationJob {
    /// All rows with seeds 1 to 3 in the folder `out`.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self {
            config: None,
            out: out.into(),
            rows: Vec::new(),
            seeds: default_seeds(),
            control: Vec::new(),
            test: Vec::new(),
            device: default_device(),
            overrides: Overrides::default(),
        }
    }
}

impl Job for AblationJob {
    const NAME: &'static str = "ablation";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = AblationReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<AblationReport> {
        ensure_folder(&self.out)?;
        let mut base = self.overrides.configuration(self.config.as_deref())?;
        find_weights(&mut base, watch)?;
        let can_run = |data: VariantData| match data {
            VariantData::None if base.network.weights.as_os_str().is_empty() => {
                Err("give the weights to score as `weights`")
            }
            VariantData::Control if self.control.is_empty() => {
                Err("give the data to train on as `control`, KIND:DIR")
            }
            _ => Ok(()),
        };
        let variants = rows(&self.rows, &can_run)?;
        let mut seeds = self.seeds.clone();
        seeds.sort_unstable();
        seeds.dedup();
        let tests = test_sets(&self.test, &base)?;
        let devices = self.device.iter().map(|name| device(name)).collect::<Result<Vec<_>, _>>()?;
        create_folder(&self.out)?;

        let settings = AblationSettings { base, control: self.control.clone(), variants, seeds };
        let runs = settings.runs().len();
        let mut number = 0;
        let mut steps = Steps::new(watch);
        let on_event = &mut |event: AblationEvent| match event {
            AblationEvent::Cell { variant, seed, done } => {
                number += 1;
                let state = if done { ", finished before" } else { "" };
                log::info!("run {number} of {runs}: {}, seed {seed}{state}", variant.title);
            }
            AblationEvent::Training(event) => steps.report(&event),
        };
        let Ablated { cells, stopped } =
            ablate(&settings, &tests, &open_made, &devices, &self.out, watch.stop, on_event)?;
        let lead = lead(&settings, &cells);
        let tables = test_tables(&cells);
        if !stopped {
            write(&self.out, &lead, &cells, &tables)?;
        }
        Ok(AblationReport { cells, stopped, out: self.out.clone(), lead, tables })
    }
}

/// The scores of every run; they serialize as a list.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
pub struct AblationReport {
    pub cells: Vec<Cell>,
    /// Whether it was stopped before the last run; `cells` are those of finished runs.
    #[serde(skip)]
    pub stopped: bool,
    #[serde(skip)]
    out: PathBuf,
    #[serde(skip)]
    lead: String,
    #[serde(skip)]
    tables: Vec<TestTables>,
}

impl Report for AblationReport {
    fn stopped(&self) -> bool {
        self.stopped
    }
}

impl fmt::Display for AblationReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.stopped {
            return writeln!(f, "{} runs are finished", self.cells.len());
        }
        writeln!(f, "{}", self.lead)?;
        write_tables(f, &all_tables(&self.tables))?;
        write_page(f, &self.out.join("ablation.html"))
    }
}

fn test_sets(given: &[Source], base: &Config) -> anyhow::Result<Vec<FlowDataset>> {
    let first;
    let sources = if given.is_empty() {
        let Some(source) = base.data.train.first() else {
            bail!("`data` is missing: name the training data, KIND:DIR");
        };
        first = [Source { split: Some(Split::Test), ..source.clone() }];
        &first[..]
    } else {
        given
    };
    let open = |source: &Source| {
        let Some(files) = source.files() else {
            bail!(
                "`test` is missing: {source} is made while training and has no test split; name one, KIND:DIR"
            );
        };
        Ok(FlowDataset::open(files, source.split)?)
    };
    sources.iter().map(open).collect()
}

/// The rows with these names; without names, all that can be run.
fn rows(
    names: &[String],
    can_run: &dyn Fn(VariantData) -> Result<(), &'static str>,
) -> anyhow::Result<Vec<Variant>> {
    if names.is_empty() {
        return Ok(variants().into_iter().filter(|row| can_run(row.data).is_ok()).collect());
    }
    let row = |name: &String| {
        let row = variants().into_iter().find(|row| row.name == *name);
        let row = row.with_context(|| format!("`rows` {name}: unknown row; the rows are {}", row_names()))?;
        can_run(row.data).map_err(|missing| anyhow!("`rows` {name}: {missing}"))?;
        Ok(row)
    };
    names.iter().map(row).collect()
}

/// What was run, in a sentence.
fn lead(settings: &AblationSettings, cells: &[Cell]) -> String {
    let network = settings.base.network.architecture.facts().title;
    let steps = cells.iter().map(|cell| cell.steps).max().unwrap_or(0);
    let seeds: Vec<String> = settings.seeds.iter().map(u64::to_string).collect();
    let tests = cells.first().map_or(&[][..], |cell| &cell.tests);
    let zero: Vec<String> = tests
        .iter()
        .map(|test| format!("{:.4} px in {} (pairs: {})", test.zero_epe, test.dataset, test.pairs))
        .collect();
    format!("{network}, {steps} steps, seeds {}; EPE of zero flow {}.", seeds.join(", "), zero.join(", "))
}

fn all_tables(ours: &[TestTables]) -> Vec<Table> {
    ours.iter().flat_map(|test| test.tables.clone()).chain(paper_tables()).collect()
}

fn write(out: &Path, lead: &str, cells: &[Cell], ours: &[TestTables]) -> anyhow::Result<()> {
    let scores = |tables: &[Table]| tables.iter().map(|table| score_table(table, "")).collect();
    let mut sections: Vec<Section> = ours
        .iter()
        .map(|test| {
            let what = "A difference within the deviation over the seeds is not significant.";
            Section::new(&test.title, what, scores(&test.tables))
        })
        .collect();
    let what = "From another resolution, another dataset and longer training: compare the order of the rows, not the values.";
    sections.push(Section::new("The paper's", what, scores(&paper_tables())));
    let report = Page {
        title: "Ablation of the regularizers".to_owned(),
        kicker: "srflow ablation".to_owned(),
        lead: lead.to_owned(),
        opening: Vec::new(),
        sections,
        colophon: format!("Made on {}.", machine::describe()),
    };
    let tables = all_tables(ours);
    let contents = [
        ("ablation.txt", format!("{lead}\n\n{}", joined(&tables, |table| table.text(TextStyle::Plain)))),
        ("ablation.md", format!("{lead}\n\n{}", markdown_file(&tables))),
        ("ablation.tex", latex(&tables)),
        ("ablation.json", serde_json::to_string_pretty(cells)? + "\n"),
        ("ablation.html", report.html()),
    ];
    for (name, text) in contents {
        write_file(&out.join(name), text)?;
    }
    Ok(())
}
