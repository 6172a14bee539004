//! The tables of a run, from its predictions.

use std::fmt;
use std::path::PathBuf;

use anyhow::Context as _;
use serde::{Deserialize, Serialize, Serializer};
use srflow_files::create_folder;
use srflow_mer::{Outcome, TABLE_FILES, all_score_tables, read_predictions, write_tables};

use crate::clap::Args;
use crate::output::{self, ensure_folder, ensure_free};
use crate::{Job, Report, Watch};

/// Recompute all tables from the predictions of a run
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[command(after_help = "\
The file is predictions.csv as `srflow mer run` writes it, or any file with the same columns: method, set, dataset, subject, \
clip, truth, epoch, predicted, score_negative, score_positive, score_surprise. The clips of a set are split into folds by \
(dataset, subject); each clip has one row per recorded epoch.

Examples:
  srflow mer tables results/predictions.csv
  srflow mer tables results/predictions.csv --out again --json")]
pub struct TablesJob {
    /// Predictions of one or several methods
    #[arg(value_name = "PREDICTIONS.csv")]
    pub predictions: PathBuf,
    /// Also write tables.{txt,csv,tex,md}, folds.csv, confusions.csv and comparisons.csv into this folder
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub out: Option<PathBuf>,
    /// Overwrite these files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

impl Job for TablesJob {
    const NAME: &'static str = "mer tables";

    type Report = TablesReport;

    fn work(&self, _: &Watch) -> anyhow::Result<TablesReport> {
        if let Some(out) = &self.out {
            ensure_folder(out)?;
            ensure_free(TABLE_FILES.map(|name| out.join(name)), self.force)?;
        }
        let trials = read_predictions(&self.predictions)?;
        let outcomes = trials
            .iter()
            .map(|trial| {
                Outcome::of_trial(trial).with_context(|| {
                    format!("{}: {}, {}", self.predictions.display(), trial.set, trial.method)
                })
            })
            .collect::<anyhow::Result<Vec<Outcome>>>()?;
        if let Some(out) = &self.out {
            create_folder(out)?;
            write_tables(out, None, &outcomes, &[])?;
        }
        Ok(TablesReport { outcomes })
    }
}

/// The scores of every set and method.
#[derive(Debug, Clone, Serialize)]
pub struct TablesReport {
    #[serde(serialize_with = "records")]
    pub outcomes: Vec<Outcome>,
}

fn records<S: Serializer>(outcomes: &[Outcome], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(outcomes.iter().map(Outcome::record))
}

impl Report for TablesReport {}

impl fmt::Display for TablesReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        output::write_tables(f, &all_score_tables(&self.outcomes, &[]))
    }
}
