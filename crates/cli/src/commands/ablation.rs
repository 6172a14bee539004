use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use clap::Args;
use srflow_eval::report::{Page, Section, score_table};
use srflow_eval::{Table, TextStyle, joined, markdown_file};
use srflow_field::{create_folder, write_file};
use srflow_ops::device;
use srflow_read::flow::{FlowDataset, Split};
use srflow_train::ablation::{
    AblationEvent, AblationSettings, Cell, Variant, ablate, paper_table, spread_table, table, variants,
};
use srflow_train::config::{Config, Source};

use super::train::{Overrides, Progress, find_weights};
use crate::made::open_made;
use crate::output::{latex, print_tables};
use crate::{Context, machine};

/// Train with each loss of the paper and print its Table V
#[derive(Args)]
#[command(after_help = "\
Trains each row with each seed, from the same weights and on the same data, and scores the last weights on the test \
split. Run the same command again to continue an interrupted run; finished runs are kept.

Example: the table at a size that two CPU cores manage
  srflow ablation --config cpu-small --data srflow:DIR --seeds 1,2,3 --out runs/ablation")]
pub struct Ablation {
    /// Preset or TOML file shared by all runs, except for its loss weights and seed [default: skflow]
    #[arg(long, value_name = "PRESET|FILE")]
    config: Option<PathBuf>,
    /// Folder for the runs and the table
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Rows to run
    #[arg(long, value_name = "ROW", value_delimiter = ',', help = rows_help())]
    rows: Vec<String>,
    /// Seeds for every row
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [1, 2, 3])]
    seeds: Vec<u64>,
    /// Dataset to score on, KIND:DIR@SPLIT [default: the test split of the first training dataset]
    #[arg(long, value_name = "KIND:DIR")]
    test: Option<Source>,
    /// Device to train on; several devices share each batch
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    device: Vec<String>,
    #[command(flatten)]
    overrides: Overrides,
}

fn rows_help() -> String {
    format!("Rows to run: {} [default: all; start, which is not trained, only with --weights]", row_names())
}

fn row_names() -> String {
    variants().into_iter().map(|row| row.name).collect::<Vec<_>>().join(", ")
}

pub fn run(args: Ablation, context: &Context) -> anyhow::Result<()> {
    crate::output::ensure_folder(&args.out)?;
    let config = match &args.config {
        Some(name) => Config::read(name)?,
        None => Config::default(),
    };
    let mut base = args.overrides.apply(config)?;
    find_weights(&mut base)?;
    let variants = rows(&args.rows, !base.network.weights.as_os_str().is_empty())?;
    let mut seeds = args.seeds;
    seeds.sort_unstable();
    seeds.dedup();
    let Some(source) = args.test.as_ref().or(base.data.train.first()) else {
        anyhow::bail!("--data KIND:DIR is missing: name the training data");
    };
    let split = if args.test.is_some() { source.split } else { Some(Split::Test) };
    let Some(files) = source.files() else {
        anyhow::bail!("--test KIND:DIR is missing: {source} is made while training and has no test split");
    };
    let test = FlowDataset::open(files, split)?;
    let devices = args.device.iter().map(|name| device(name)).collect::<Result<Vec<_>, _>>()?;
    create_folder(&args.out)?;

    let settings = AblationSettings { base, variants, seeds };
    let runs = settings.runs().len();
    let mut number = 0;
    let mut progress = Progress::new();
    let result = ablate(&settings, &test, &open_made, &devices, &args.out, &mut |event| match event {
        AblationEvent::Cell { variant, seed, done } => {
            number += 1;
            let state = if done { ", finished before" } else { "" };
            progress.line(&format!("run {number} of {runs}: {}, seed {seed}{state}", variant.title));
        }
        AblationEvent::Training(event) => progress.show(&event),
    });
    progress.finish();
    let cells = result?;
    let tables = tables(&settings, &cells, &test);
    write(&args.out, &cells, &tables)?;
    if context.json {
        crate::output::print_json(&cells)?;
        return Ok(());
    }
    print_tables(&tables)?;
    say!("\nReport: {}", args.out.join("ablation.html").display())
}

/// The rows with these names; without names, all that can be run.
fn rows(names: &[String], has_weights: bool) -> anyhow::Result<Vec<Variant>> {
    if names.is_empty() {
        return Ok(variants().into_iter().filter(|row| row.trained || has_weights).collect());
    }
    let row = |name: &String| {
        let row = variants().into_iter().find(|row| row.name == *name);
        let row = row.with_context(|| format!("--rows {name}: unknown row; the rows are {}", row_names()))?;
        ensure!(row.trained || has_weights, "--rows {name}: give the weights to score, --weights FILE");
        Ok(row)
    };
    names.iter().map(row).collect()
}

/// Our means, our standard deviations, and the paper's values.
fn tables(settings: &AblationSettings, cells: &[Cell], test: &FlowDataset) -> [Table; 3] {
    let network = settings.base.network.architecture.facts().title;
    let steps = cells.iter().map(|cell| cell.steps).max().unwrap_or(0);
    let zero = cells.first().map_or(f64::NAN, |cell| cell.zero_epe);
    let seeds: Vec<String> = settings.seeds.iter().map(u64::to_string).collect();
    let what = format!(
        "{network}, {steps} steps, {} ({} split), EPE of zero flow {zero:.4} px",
        test.name(),
        test.split()
    );
    [
        table(cells, format!("Ours: mean over seeds {} of {what}", seeds.join(", "))),
        spread_table(cells, "Ours: standard deviation over the seeds".to_owned()),
        paper_table(),
    ]
}

fn write(out: &std::path::Path, cells: &[Cell], tables: &[Table; 3]) -> anyhow::Result<()> {
    let report = Page {
        title: "Ablation of the regularizers".to_owned(),
        kicker: "srflow ablation".to_owned(),
        lead: "The same training with one loss at a time. The paper's numbers come from another resolution, another dataset and \
        longer training: compare the order of the rows, not the values."
            .to_owned(),
        opening: Vec::new(),
        sections: vec![
            Section::new("Ours", "Means over the seeds, and their standard deviation: a difference within the spread is not significant.", vec![score_table(&tables[0], ""), score_table(&tables[1], "")]),
            Section::new("The paper's", "", vec![score_table(&tables[2], "")]),
        ],
        colophon: format!("Made on {}.", machine::describe()),
    };
    let contents = [
        ("ablation.txt", joined(tables, |table| table.text(TextStyle::Plain))),
        ("ablation.md", markdown_file(tables)),
        ("ablation.tex", latex(tables)),
        ("ablation.json", serde_json::to_string_pretty(cells)? + "\n"),
        ("ablation.html", report.html()),
    ];
    for (name, text) in contents {
        write_file(&out.join(name), text)?;
    }
    Ok(())
}
