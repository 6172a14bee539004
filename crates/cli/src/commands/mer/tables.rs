use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_files::create_folder;
use srflow_mer::{Outcome, OutcomeRecord, TABLE_FILES, all_score_tables, read_predictions, write_tables};

use crate::Context;
use crate::output::{ensure_free, print_tables};

/// Recompute all tables from the predictions of a run
#[derive(Args)]
#[command(after_help = "\
The file is predictions.csv as `srflow mer run` writes it, or any file with the same columns: method, set, dataset, subject, \
clip, truth, epoch, predicted, score_negative, score_positive, score_surprise. The clips of a set are split into folds by \
(dataset, subject); each clip has one row per recorded epoch.

Examples:
  srflow mer tables results/predictions.csv
  srflow mer tables results/predictions.csv --out again --json")]
pub struct Tables {
    /// Predictions of one or several methods
    #[arg(value_name = "PREDICTIONS.csv")]
    predictions: PathBuf,
    /// Also write tables.{txt,csv,tex,md}, folds.csv and confusions.csv into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Overwrite these files
    #[arg(long)]
    force: bool,
}

#[derive(Serialize)]
struct Recomputed {
    outcomes: Vec<OutcomeRecord>,
}

pub fn run(args: Tables, context: &Context) -> anyhow::Result<()> {
    if let Some(out) = &args.out {
        crate::output::ensure_folder(out)?;
        ensure_free(TABLE_FILES.map(|name| out.join(name)), args.force)?;
    }
    let trials = read_predictions(&args.predictions)?;
    let outcomes = trials
        .iter()
        .map(|trial| {
            Outcome::of_trial(trial)
                .with_context(|| format!("{}: {}, {}", args.predictions.display(), trial.set, trial.method))
        })
        .collect::<anyhow::Result<Vec<Outcome>>>()?;
    if let Some(out) = &args.out {
        create_folder(out)?;
        write_tables(out, &outcomes, &[])?;
    }
    if context.json {
        let recomputed = Recomputed { outcomes: outcomes.iter().map(Outcome::record).collect() };
        return crate::output::print_json(&recomputed);
    }
    print_scores(&outcomes, &[])
}

/// Prints the score tables of every set; see [`all_score_tables`].
pub fn print_scores(outcomes: &[Outcome], left_out: &[String]) -> anyhow::Result<()> {
    print_tables(&all_score_tables(outcomes, left_out))
}
