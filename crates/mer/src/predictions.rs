//! Predictions, clip by clip, and their file: all results can be recomputed from it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use srflow_core::{excerpt, is_unprintable};
use srflow_files::{FileError, FileKind, open_file, write_atomically};
use srflow_report::{csv_cell, csv_value};

/// A classifier's prediction for a clip after an epoch of training on all other subjects.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// The dataset's kind, e.g. `casme2`.
    pub dataset: String,
    /// The subject, which identifies the fold.
    pub subject: String,
    pub clip: String,
    /// True class number.
    pub truth: usize,
    /// Seed of the training; 0 where there is none.
    pub seed: u64,
    /// Number of previous epochs, so that the first is 0.
    pub epoch: usize,
    /// Predicted class number.
    pub predicted: usize,
    /// The classifier's output for each class before any softmax; the largest one is the prediction.
    pub scores: Vec<f32>,
}

/// All predictions of one leave-one-subject-out run.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The flow method of the features.
    pub method: String,
    /// The set of clips: a dataset's kind, or `composite`.
    pub set: String,
    /// The classes' names, by their numbers.
    pub classes: Arc<[String]>,
    /// For every clip of the set and every recorded epoch.
    pub predictions: Vec<Prediction>,
}

/// Why a file of predictions could not be read.
#[derive(Debug, thiserror::Error)]
pub enum PredictionsError {
    /// The file could not be opened.
    #[error(transparent)]
    File(#[from] FileError),
    #[error("{}: {}; expected a predictions.csv as `srflow mer run` writes it", .path.display(), excerpt(&.error.to_string()))]
    Csv {
        path: PathBuf,
        /// What is wrong, and in which line.
        error: csv::Error,
    },
    #[error(
        "{}: there is no column {}; expected a predictions.csv as `srflow mer run` writes it, with the columns {} and score_CLASS for each class",
        .path.display(), .missing.join(", "), COLUMNS.join(", ")
    )]
    Columns {
        path: PathBuf,
        /// The columns that are not there.
        missing: Vec<&'static str>,
    },
    #[error("{}: it holds no predictions; expected a predictions.csv as `srflow mer run` writes it", .path.display())]
    Empty { path: PathBuf },
    /// An unknown class, a prediction that is not the largest score, or not a number.
    #[error("{}: line {line}: {reason}", .path.display())]
    Value {
        path: PathBuf,
        /// Line number, from 1 for the header.
        line: u64,
        /// What was found, and what was expected.
        reason: String,
    },
}

impl Prediction {
    /// The class of the largest score; the first of equal ones.
    pub fn class_of(scores: &[f32]) -> usize {
        (1..scores.len()).fold(0, |best, class| if scores[class] > scores[best] { class } else { best })
    }
}

/// The columns before the scores; their order is free.
const COLUMNS: [&str; 8] = ["method", "set", "dataset", "subject", "clip", "truth", "epoch", "predicted"];
/// Column that a file lacks where all seeds are 0.
const SEED: &str = "seed";
/// Prefix of a score column, followed by the class: these columns define the classes' names and order.
const SCORE: &str = "score_";
/// As many classes as clips can be divided into.
const MAX_CLASSES: usize = 10;

/// Writes predictions as CSV, one line for each; all trials must have the same classes. Scores are written with enough digits to
/// restore their bits.
///
/// # Errors
/// When the file cannot be written.
pub fn write_predictions(path: &Path, trials: &[Trial]) -> Result<(), FileError> {
    write_atomically(path, |file| {
        let mut writer = csv::Writer::from_writer(file);
        let classes = trials.first().map_or(&[][..], |trial| &trial.classes);
        let scores = classes.iter().map(|class| format!("{SCORE}{class}"));
        let seeded =
            trials.iter().flat_map(|trial| &trial.predictions).any(|prediction| prediction.seed != 0);
        let seed = seeded.then(|| SEED.to_owned());
        writer.write_record(COLUMNS.map(str::to_owned).into_iter().chain(seed).chain(scores))?;
        for Trial { method, set, classes, predictions } in trials {
            for Prediction { dataset, subject, clip, truth, seed, epoch, predicted, scores } in predictions {
                let epoch = epoch.to_string();
                let fixed =
                    [method, set, dataset, subject, clip, &classes[*truth], &epoch, &classes[*predicted]];
                let scores = scores.iter().map(|score| match score.is_finite() {
                    true => serde_json::to_string(score).unwrap_or_default(),
                    false => score.to_string(),
                });
                let fixed = fixed.into_iter().map(|text| csv_cell(text).into_owned());
                let seed = seeded.then(|| seed.to_string());
                writer.write_record(fixed.chain(seed).chain(scores))?;
            }
        }
        writer.flush()
    })
}

/// Reads a file of [`write_predictions`]; trials are in order of first appearance.
///
/// # Errors
/// When the file cannot be read, is empty or holds something else.
pub fn read_predictions(path: &Path) -> Result<Vec<Trial>, PredictionsError> {
    let broken = |error| PredictionsError::Csv { path: path.to_owned(), error };
    let mut reader = csv::Reader::from_reader(open_file(path, FileKind::Table)?.0);
    let head = reader.headers().map_err(broken)?.clone();
    if head.is_empty() {
        return Err(PredictionsError::Empty { path: path.to_owned() });
    }
    let place = |column: &str| head.iter().position(|name| name == column);
    let missing: Vec<&str> = COLUMNS.into_iter().filter(|column| place(column).is_none()).collect();
    let scores: Vec<(usize, String)> = head
        .iter()
        .enumerate()
        .filter_map(|(at, name)| Some((at, name.strip_prefix(SCORE)?.to_owned())))
        .collect();
    if !missing.is_empty() {
        return Err(PredictionsError::Columns { path: path.to_owned(), missing });
    }
    if !(2..=MAX_CLASSES).contains(&scores.len()) {
        let found = scores.len();
        let reason =
            format!("expected 2 to {MAX_CLASSES} columns {SCORE}CLASS, one for each class, found {found}");
        return Err(PredictionsError::Value { path: path.to_owned(), line: 1, reason });
    }
    if let Some((_, class)) = scores.iter().find(|(_, class)| class.contains(is_unprintable)) {
        let reason = format!("expected printable names of classes, found `{}`", excerpt(class));
        return Err(PredictionsError::Value { path: path.to_owned(), line: 1, reason });
    }
    let columns = COLUMNS.map(|column| place(column).unwrap_or(0));
    let seed_column = place(SEED);
    let classes: Arc<[String]> = scores.iter().map(|(_, class)| class.clone()).collect();
    let mut trials: Vec<Trial> = Vec::new();
    let mut numbers: HashMap<[String; 2], usize> = HashMap::new();
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).map_err(broken)? {
        let line = record.position().map_or(0, csv::Position::line);
        let refused = |reason| PredictionsError::Value { path: path.to_owned(), line, reason };
        let [method, set, dataset, subject, clip, truth, epoch, predicted] =
            columns.map(|at| csv_value(record.get(at).unwrap_or_default()));
        let class = |name: &str| {
            let is = |(number, class): (usize, &String)| {
                class.eq_ignore_ascii_case(name.trim()) || number.to_string() == name.trim()
            };
            classes.iter().enumerate().position(is).ok_or_else(|| {
                refused(format!(
                    "`{}` is not a class; the columns score_... name {}",
                    excerpt(name),
                    classes.join(", ")
                ))
            })
        };
        let (truth, predicted) = (class(truth)?, class(predicted)?);
        let epoch = whole("epoch", epoch).map_err(refused)?;
        let seed = seed_column.map(|at| whole(SEED, record.get(at).unwrap_or_default()));
        let seed = seed.transpose().map_err(refused)?.unwrap_or(0);
        let score = |(at, class): &(usize, String)| {
            let text = record.get(*at).unwrap_or_default();
            text.trim()
                .parse::<f32>()
                .map_err(|_| refused(format!("{SCORE}{class}: expected a number, found `{}`", excerpt(text))))
        };
        let scores: Vec<f32> = scores.iter().map(score).collect::<Result<_, _>>()?;
        let largest = Prediction::class_of(&scores);
        if largest != predicted {
            return Err(refused(format!(
                "predicted is {}, but the largest score is that of {}",
                classes[predicted], classes[largest]
            )));
        }
        let number = *numbers.entry([set.to_owned(), method.to_owned()]).or_insert_with(|| {
            trials.push(Trial {
                method: method.to_owned(),
                set: set.to_owned(),
                classes: classes.clone(),
                predictions: Vec::new(),
            });
            trials.len() - 1
        });
        trials[number].predictions.push(Prediction {
            dataset: dataset.to_owned(),
            subject: subject.to_owned(),
            clip: clip.to_owned(),
            truth,
            seed,
            epoch,
            predicted,
            scores,
        });
    }
    if trials.is_empty() { Err(PredictionsError::Empty { path: path.to_owned() }) } else { Ok(trials) }
}

/// The number in a cell of a column.
fn whole<T: FromStr>(column: &str, text: &str) -> Result<T, String> {
    let parsed = text.trim().parse();
    parsed.map_err(|_| format!("{column}: expected a whole number from 0, found `{}`", excerpt(text)))
}
