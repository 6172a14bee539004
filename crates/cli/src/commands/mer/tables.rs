use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use clap::Args;
use serde::Serialize;
use srflow_eval::{Table, TextStyle, latex_file};
use srflow_field::{create_folder, write_atomically};
use srflow_mer::{
    Outcome, OutcomeRecord, by_set, confusion_latex, confusion_title, confusions_csv, folds_csv,
    read_predictions, score_tables, scores_csv,
};

use crate::Context;

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
struct Report {
    outcomes: Vec<OutcomeRecord>,
}

/// Runs the command.
pub fn run(args: Tables, context: &Context) -> anyhow::Result<()> {
    if let (Some(out), false) = (&args.out, args.force) {
        let there = TABLE_FILES.iter().map(|name| out.join(name)).find(|path| path.exists());
        ensure!(
            there.is_none(),
            "{} is there already; --force overwrites it",
            there.unwrap_or_default().display()
        );
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
        let report = Report { outcomes: outcomes.iter().map(Outcome::record).collect() };
        return say!("{}", serde_json::to_string_pretty(&report)?);
    }
    print_scores(&outcomes)
}

/// Prints the score tables of every set.
pub fn print_scores(outcomes: &[Outcome]) -> anyhow::Result<()> {
    let colours = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    let style = if colours { TextStyle::Ansi } else { TextStyle::Plain };
    say!("{}", joined(&scores(outcomes), |table| table.text(style)).trim_end())
}

/// Writes [`TABLE_FILES`].
pub fn write_tables(folder: &Path, outcomes: &[Outcome]) -> anyhow::Result<()> {
    let scores = scores(outcomes);
    let texts: [String; 6] = [
        joined(&scores, |table| table.text(TextStyle::Plain)),
        scores_csv(outcomes),
        latex(&scores, outcomes),
        joined(&scores, |table| format!("{}\n\n{}", table.title, table.markdown())),
        folds_csv(outcomes),
        confusions_csv(outcomes),
    ];
    for (name, text) in TABLE_FILES.iter().zip(texts) {
        write_text(&folder.join(name), &text)?;
    }
    Ok(())
}

/// Writes a text file whole or not at all.
pub fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    write_atomically(path, |file| std::io::Write::write_all(file, text.as_bytes()))
        .with_context(|| format!("writing {}", path.display()))
}

fn scores(outcomes: &[Outcome]) -> Vec<Table> {
    by_set(outcomes).iter().flat_map(|of_set| score_tables(of_set)).collect()
}

fn latex(scores: &[Table], outcomes: &[Outcome]) -> String {
    let scores = scores.iter().map(|table| (table.title.clone(), table.latex()));
    let confusions = outcomes.iter().map(|outcome| (confusion_title(outcome), confusion_latex(outcome)));
    latex_file(scores.chain(confusions))
}

fn joined(tables: &[Table], form: impl Fn(&Table) -> String) -> String {
    tables.iter().map(form).collect::<Vec<_>>().join("\n")
}
