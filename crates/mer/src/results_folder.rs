//! The folder of a run's results.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use srflow_data::micro_expression::Clip;
use srflow_eval::MethodRecord;
use srflow_files::{FileError, FileProblem, create_folder, write_file};
use srflow_report::{Table, TextStyle, joined, latex_file, markdown_file};

use crate::apex::ApexRule;
use crate::comparison::{Comparison, comparisons};
use crate::head_motion::SubtractedMotion;
use crate::outcome::{Outcome, OutcomeRecord, by_set};
use crate::predictions::write_predictions;
use crate::protocol::Protocol;
use crate::report::{ReportError, ReportParts, report};
use crate::results::{confusion_latex, confusion_title, score_tables};
use crate::results_csv::{comparisons_csv, confusions_csv, folds_csv, scores_csv};
use crate::run::{DataRecord, FeatureSet, RunResults};

/// The files with tables, as [`write_tables`] writes them.
pub const TABLE_FILES: [&str; 7] =
    ["tables.txt", "tables.csv", "tables.tex", "tables.md", "folds.csv", "confusions.csv", "comparisons.csv"];
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

/// When, where and by which job results were computed.
#[derive(Debug, Clone, Serialize)]
pub struct Origin {
    /// As in RFC 3339.
    pub date: String,
    pub machine: String,
    /// Every setting of the job.
    pub job: serde_json::Value,
}

/// The contents of `results.json`.
#[derive(Debug, Serialize)]
pub struct ResultsRecord<'a> {
    protocol_name: &'static str,
    preparation: String,
    classifier: &'static str,
    /// Of the training, where it has epochs.
    #[serde(skip_serializing_if = "Option::is_none")]
    protocol: Option<&'a Protocol>,
    srflow: &'static str,
    #[serde(flatten)]
    origin: &'a Origin,
    data: &'a [DataRecord],
    classes: &'a [String],
    methods: &'a [MethodRecord],
    apex: Option<&'static str>,
    outcomes: Vec<OutcomeRecord>,
    comparisons: Vec<Comparison>,
    clips: Vec<ClipRecord<'a>>,
}

/// A clip as it was used.
#[derive(Debug, Serialize)]
struct ClipRecord<'a> {
    dataset: &'a str,
    subject: &'a str,
    clip: &'a str,
    onset: u64,
    apex: Option<u64>,
    /// Whether the apex was spotted, not annotated.
    apex_spotted: bool,
    /// The motion of the head that was subtracted from each method's flow.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    head_motion: BTreeMap<&'a str, SubtractedMotion>,
}

impl<'a> ResultsRecord<'a> {
    pub fn of(results: &'a RunResults, origin: &'a Origin) -> Self {
        let settings = &results.settings;
        let FeatureSet { data, clips, samples, apex_spotted } = &results.features;
        let clip = |(number, clip): (usize, &'a Clip)| ClipRecord {
            dataset: &clip.dataset,
            subject: &clip.annotation.subject,
            clip: &clip.annotation.clip,
            onset: clip.annotation.onset,
            apex: clip.annotation.apex,
            apex_spotted: apex_spotted[number],
            head_motion: samples
                .iter()
                .filter_map(|(method, samples)| Some((method.as_str(), samples[number].head_motion?)))
                .collect(),
        };
        Self {
            protocol_name: settings.recognition.name(),
            preparation: settings.preparation.to_string(),
            classifier: settings.classifier.facts.name,
            protocol: settings.classifier.by_epochs.then_some(&settings.protocol),
            srflow: env!("CARGO_PKG_VERSION"),
            origin,
            data,
            classes: &settings.classes,
            methods: &results.methods,
            apex: settings.apex.map(ApexRule::name),
            outcomes: results.outcomes.iter().map(Outcome::record).collect(),
            comparisons: by_set(&results.outcomes).iter().flat_map(|of_set| comparisons(of_set)).collect(),
            clips: clips.iter().enumerate().map(clip).collect(),
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
    pub fn write(&self, results: &RunResults, origin: &Origin) -> Result<(), ResultsError> {
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
        let heading = results.settings.heading();
        write_tables(&self.folder, Some(&heading), &results.outcomes, &results.settings.left_out)?;
        write_predictions(&self.file(PREDICTIONS), &results.trials)?;
        let parts = ReportParts {
            outcomes: &results.outcomes,
            left_out: &results.settings.left_out,
            trials: &results.trials,
            samples: &results.features.samples,
            clips: &results.features.clips,
            face: &results.settings.preparation.face,
            facts: facts(results),
            machine: origin.machine.clone(),
        };
        write_file(&self.report(), report(&parts)?.html())?;
        let record = serde_json::to_string_pretty(&ResultsRecord::of(results, origin));
        Ok(write_file(&last, record.expect("numbers and text") + "\n")?)
    }
}

/// Writes [`TABLE_FILES`]; see [`all_score_tables`]. The tables for people begin with a heading.
///
/// # Errors
/// When a file cannot be written.
pub fn write_tables(
    folder: &Path,
    heading: Option<&str>,
    outcomes: &[Outcome],
    left_out: &[String],
) -> Result<(), FileError> {
    let scores = all_score_tables(outcomes, left_out);
    let headed = |before: &str, text: &str| match heading {
        Some(heading) => format!("{before}{heading}\n\n{text}"),
        None => text.to_owned(),
    };
    let texts: [String; 7] = [
        headed("", &joined(&scores, |table| table.text(TextStyle::Plain))),
        scores_csv(outcomes),
        headed("% ", &latex(&scores, outcomes)),
        headed("", &markdown_file(&scores)),
        folds_csv(outcomes),
        confusions_csv(outcomes),
        comparisons_csv(outcomes),
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
    for data in &results.features.data {
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
    facts.push(("Classes".to_owned(), settings.classes.join(", ")));
    facts.push(("Protocol".to_owned(), settings.recognition.to_string()));
    facts.push(("Frames".to_owned(), settings.preparation.to_string()));
    facts.extend(results.methods.iter().map(|method| (method.name.clone(), method.description())));
    facts.push(("Classifier".to_owned(), settings.training()));
    if settings.classifier.by_epochs {
        let Protocol { epochs, record_every, batch, learning_rate, decay_every, decay, seed, seeds, .. } =
            &settings.protocol;
        let last = seed.wrapping_add(*seeds as u64 - 1);
        let seeds = if *seeds == 1 { format!("seed {seed}") } else { format!("seeds {seed} to {last}") };
        facts.push((
            "Training".to_owned(),
            format!(
                "{epochs} epochs, recorded every {record_every}, batch {batch}, Adam {learning_rate}, times {decay} every \
                 {decay_every} epochs, {seeds}"
            ),
        ));
    }
    facts
}
