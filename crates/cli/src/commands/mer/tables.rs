use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_eval::{Table, TextStyle, latex_file};
use srflow_field::create_folder;
use srflow_mer::{
    Outcome, OutcomeRecord, by_set, confusion_latex, confusion_title, confusions_csv, folds_csv,
    read_predictions, score_tables, scores_csv,
};

use crate::Context;
use crate::output::{ensure_free, joined, markdown, print_tables, write_text};

/// Recompute every table from the predictions of a run
#[derive(Args)]
#[command(after_help = "\
The file is predictions.csv as `srflow mer run` writes it, or anybody's with the same columns: method, set, dataset, \
subject, clip, truth, epoch, predicted, score_negative, score_positive, score_surprise. A set's clips are divided into \
folds by (dataset, subject); every clip stands once for each epoch.

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

/// The files with tables.
pub const TABLE_FILES: [&str; 6] =
    ["tables.txt", "tables.csv", "tables.tex", "tables.md", "folds.csv", "confusions.csv"];

#[derive(Serialize)]
struct Outcomes {
    outcomes: Vec<OutcomeRecord>,
}

/// Runs the command.
pub fn run(args: Tables, context: &Context) -> anyhow::Result<()> {
    if let Some(out) = &args.out {
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
        write_tables(out, &outcomes)?;
    }
    if context.json {
        let outcomes = Outcomes { outcomes: outcomes.iter().map(Outcome::record).collect() };
        return say!("{}", serde_json::to_string_pretty(&outcomes)?);
    }
    print_scores(&outcomes)
}

/// Prints the score tables of every set.
pub fn print_scores(outcomes: &[Outcome]) -> anyhow::Result<()> {
    print_tables(&scores(outcomes))
}

/// Writes [`TABLE_FILES`].
pub fn write_tables(folder: &Path, outcomes: &[Outcome]) -> anyhow::Result<()> {
    let scores = scores(outcomes);
    let texts: [String; 6] = [
        joined(&scores, |table| table.text(TextStyle::Plain)),
        scores_csv(outcomes),
        latex(&scores, outcomes),
        markdown(&scores),
        folds_csv(outcomes),
        confusions_csv(outcomes),
    ];
    for (name, text) in TABLE_FILES.iter().zip(texts) {
        write_text(&folder.join(name), &text)?;
    }
    Ok(())
}

fn scores(outcomes: &[Outcome]) -> Vec<Table> {
    by_set(outcomes).iter().flat_map(|of_set| score_tables(of_set)).collect()
}

fn latex(scores: &[Table], outcomes: &[Outcome]) -> String {
    let scores = scores.iter().map(|table| (table.title.clone(), table.latex()));
    let confusions = outcomes.iter().map(|outcome| (confusion_title(outcome), confusion_latex(outcome)));
    latex_file(scores.chain(confusions))
}
