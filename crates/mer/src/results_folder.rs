//! The folder of a run's results.

use std::path::{Path, PathBuf};

use serde::Serialize;
use srflow_eval::MethodRecord;
use srflow_files::{FileError, FileProblem, create_folder, write_file};
use srflow_report::{Table, TextStyle, joined, latex_file, markdown_file};

use crate::apex::ApexRule;
use crate::predictions::write_predictions;
use crate::protocol::Protocol;
use crate::report::{ReportError, ReportParts, report};
use crate::results::{Outcome, OutcomeRecord, by_set, confusion_latex, confusion_title, score_tables};
use crate::results_csv::{confusions_csv, folds_csv, scores_csv};
use crate::run::{DataRecord, RunResults};

/// The files with tables, as [`write_tables`] writes them.
pub const TABLE_FILES: [&str; 6] =
    ["tables.txt", "tables.csv", "tables.tex", "tables.md", "folds.csv", "confusions.csv"];
const PREDICTIONS: &str = "predictions.csv";
const REPORT: &str = "report.html";
/// Written last: its existence marks the results as complete.
const RESULTS: &str = "results.json";

/// The destination of a run's results: [`TABLE_FILES`], `predictions.csv`, `report.html` and `results.json`. Finished folds are
/// stored in `folds`, so that an interrupted run can continue.
#[derive(Debug, Clone)]
pub struct ResultsFolder {
    folder: PathBuf,
}

/// Why results could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ResultsError {
    #[error("{} exists; give `force` to overwrite it, or another folder", .0.display())]
    Exists(PathBuf),
    /// A file could not be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The report could not be created.
    #[error(transparent)]
    Report(#[from] ReportError),
}

/// The contents of `results.json`.
#[derive(Debug, Serialize)]
pub struct ResultsRecord<'a> {
    data: &'a [DataRecord],
    classes: &'a [String],
    methods: &'a [MethodRecord],
    classifier: &'static str,
    preparation: String,
    apex: Option<&'static str>,
    protocol: &'a Protocol,
    machine: &'a str,
    outcomes: Vec<OutcomeRecord>,
}

impl<'a> ResultsRecord<'a> {
    /// The record of results computed on `machine`.
    pub fn of(results: &'a RunResults, machine: &'a str) -> Self {
        let settings = &results.settings;
        Self {
            data: &results.data,
            classes: &settings.classes,
            methods: &results.methods,
            classifier: settings.classifier.facts.name,
            preparation: settings.preparation.to_string(),
            apex: settings.apex.map(ApexRule::name),
            protocol: &settings.protocol,
            machine,
            outcomes: results.outcomes.iter().map(Outcome::record).collect(),
        }
    }
}

impl ResultsFolder {
    /// The folder with this path as the destination of a run.
    ///
    /// # Errors
    /// When it has the results of a run, or files with their names that belong to no interrupted run, and `force` is not set.
    pub fn open(folder: &Path, force: bool) -> Result<Self, ResultsError> {
        let this = Self { folder: folder.to_owned() };
        let unfinished = this.folds().is_dir() && !this.file(RESULTS).exists();
        if !force && !unfinished {
            let mut files = TABLE_FILES.into_iter().chain([PREDICTIONS, REPORT, RESULTS]);
            if let Some(name) = files.find(|name| this.file(name).exists()) {
                return Err(ResultsError::Exists(this.file(name)));
            }
        }
        Ok(this)
    }

    /// The folder of finished folds.
    pub fn folds(&self) -> PathBuf {
        self.file("folds")
    }

    pub fn report(&self) -> PathBuf {
        self.file(REPORT)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Writes all files of the results.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, results: &RunResults, machine: &str) -> Result<(), ResultsError> {
        create_folder(&self.folder)?;
        let last = self.file(RESULTS);
        match std::fs::remove_file(&last) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(
                    FileError { path: last, problem: FileProblem::Io { doing: "removing", error } }.into()
                );
            }
            _ => {}
        }
        write_tables(&self.folder, &results.outcomes, &results.settings.left_out)?;
        write_predictions(&self.file(PREDICTIONS), &results.trials)?;
        let parts = ReportParts {
            outcomes: &results.outcomes,
            left_out: &results.settings.left_out,
            trials: &results.trials,
            samples: &results.samples,
            clips: &results.clips,
            face: &results.settings.preparation.face,
            facts: facts(results),
            machine: machine.to_owned(),
        };
        write_file(&self.report(), report(&parts)?.html())?;
        let record = serde_json::to_string_pretty(&ResultsRecord::of(results, machine));
        Ok(write_file(&last, record.expect("numbers and text") + "\n")?)
    }
}

/// Writes [`TABLE_FILES`]; see [`all_score_tables`].
///
/// # Errors
/// When a file cannot be written.
pub fn write_tables(folder: &Path, outcomes: &[Outcome], left_out: &[String]) -> Result<(), FileError> {
    let scores = all_score_tables(outcomes, left_out);
    let texts: [String; 6] = [
        joined(&scores, |table| table.text(TextStyle::Plain)),
        scores_csv(outcomes),
        latex(&scores, outcomes),
        markdown_file(&scores),
        folds_csv(outcomes),
        confusions_csv(outcomes),
    ];
    TABLE_FILES.iter().zip(texts).try_for_each(|(name, text)| write_file(&folder.join(name), text))
}

/// The [`score_tables`] of every set, with a sentence for each row that was left out below them.
pub fn all_score_tables(outcomes: &[Outcome], left_out: &[String]) -> Vec<Table> {
    by_set(outcomes).iter().flat_map(|of_set| score_tables(of_set, left_out)).collect()
}

fn latex(scores: &[Table], outcomes: &[Outcome]) -> String {
    let scores = scores.iter().map(|table| (table.title.clone(), table.latex()));
    let confusions = outcomes.iter().map(|outcome| (confusion_title(outcome), confusion_latex(outcome)));
    latex_file(scores.chain(confusions))
}

/// Settings of a run for the report: names and values.
fn facts(results: &RunResults) -> Vec<(String, String)> {
    let mut facts: Vec<(String, String)> = Vec::new();
    for data in &results.data {
        let mut text =
            format!("{} clips of {} subjects, {} rows left out", data.clips, data.subjects, data.dropped);
        if data.spotted_apexes > 0 {
            text += &format!(", apex of {} clips spotted", data.spotted_apexes);
        }
        if !data.clips_with_missing_frames.is_empty() {
            text += &format!(", frames missing in {}", data.clips_with_missing_frames.join(", "));
        }
        facts.push((data.dataset.clone(), text));
    }
    let settings = &results.settings;
    let Protocol { epochs, record_every, batch, learning_rate, decay_every, decay, seed } =
        &settings.protocol;
    facts.push(("Classes".to_owned(), settings.classes.join(", ")));
    facts.push(("Frames".to_owned(), settings.preparation.to_string()));
    facts.extend(results.methods.iter().map(|method| (method.name.clone(), method.description())));
    facts.push(("Classifier".to_owned(), settings.classifier.facts.name.to_owned()));
    facts.push((
        "Training".to_owned(),
        format!(
            "{epochs} epochs, recorded every {record_every}, batch {batch}, Adam {learning_rate}, times {decay} every \
             {decay_every} epochs, seed {seed}"
        ),
    ));
    facts
}
