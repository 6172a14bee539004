//! What classifiers said, clip by clip, and the file that keeps it: every number of the results follows from it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_field::{FileError, FileKind, excerpt, open_file, write_atomically};
use srflow_read::micro_expression::EmotionClass;

use crate::metrics::CLASSES;

/// What a classifier said of a clip after an epoch of training on everybody but the clip's subject.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// The dataset's kind, e.g. `casme2`.
    pub dataset: String,
    /// The subject, who is the fold.
    pub subject: String,
    /// The clip.
    pub clip: String,
    /// What it shows.
    pub truth: EmotionClass,
    /// Epochs before this one, so that the first is 0.
    pub epoch: usize,
    /// What the classifier took it for.
    pub predicted: EmotionClass,
    /// The classifier's output for each class before any softmax; the largest is the prediction.
    pub scores: [f32; CLASSES],
}

/// All predictions of one leave-one-subject-out run.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// The flow method that the features come from.
    pub method: String,
    /// The set of clips that the folds divide: a dataset's kind, or `composite`.
    pub set: String,
    /// For every clip of the set and every recorded epoch.
    pub predictions: Vec<Prediction>,
}

/// Why a file of predictions was not read.
#[derive(Debug, thiserror::Error)]
pub enum PredictionsError {
    /// The file could not be opened.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is no CSV file, or a line lacks a column or holds something else in it.
    #[error("{}: {}; expected a predictions.csv as `srflow mer run` writes it", .path.display(), excerpt(&.error.to_string()))]
    Csv {
        /// The file.
        path: PathBuf,
        /// What is wrong, and in which line.
        error: csv::Error,
    },
    /// The head names other columns.
    #[error(
        "{}: there is no column {}; expected a predictions.csv as `srflow mer run` writes it, with the columns {}",
        .path.display(), .missing.join(", "), COLUMNS.join(", ")
    )]
    Columns {
        /// The file.
        path: PathBuf,
        /// The columns that are not there.
        missing: Vec<&'static str>,
    },
    /// There is not a single prediction.
    #[error("{}: it holds no predictions; expected a predictions.csv as `srflow mer run` writes it", .path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A class of another name, or one that the scores do not say.
    #[error("{}: line {line}: {reason}", .path.display())]
    Class {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1 with the head.
        line: u64,
        /// What stands there and what should.
        reason: String,
    },
}

impl Prediction {
    /// The class of the largest score; the first of equal ones.
    pub fn class_of(scores: &[f32; CLASSES]) -> EmotionClass {
        let best =
            (1..CLASSES).fold(0, |best, class| if scores[class] > scores[best] { class } else { best });
        EmotionClass::ALL[best]
    }
}

/// The columns of the file; their order is free.
const COLUMNS: [&str; 11] = [
    "method",
    "set",
    "dataset",
    "subject",
    "clip",
    "truth",
    "epoch",
    "predicted",
    "score_negative",
    "score_positive",
    "score_surprise",
];

/// A line of the file.
#[derive(Serialize, Deserialize)]
struct Line<'a> {
    method: &'a str,
    set: &'a str,
    dataset: &'a str,
    subject: &'a str,
    clip: &'a str,
    truth: &'a str,
    epoch: usize,
    predicted: &'a str,
    score_negative: f32,
    score_positive: f32,
    score_surprise: f32,
}

/// Writes predictions as CSV, one line for each. Scores are written with as many digits as give back their bits.
///
/// # Errors
/// When the file cannot be written.
pub fn write_predictions(path: &Path, trials: &[Trial]) -> Result<(), FileError> {
    write_atomically(path, |file| {
        let mut writer = csv::Writer::from_writer(file);
        for trial in trials {
            for prediction in &trial.predictions {
                let [score_negative, score_positive, score_surprise] = prediction.scores;
                writer.serialize(Line {
                    method: &trial.method,
                    set: &trial.set,
                    dataset: &prediction.dataset,
                    subject: &prediction.subject,
                    clip: &prediction.clip,
                    truth: prediction.truth.name(),
                    epoch: prediction.epoch,
                    predicted: prediction.predicted.name(),
                    score_negative,
                    score_positive,
                    score_surprise,
                })?;
            }
        }
        writer.flush()
    })
}

/// Reads what [`write_predictions`] wrote; trials in the order in which the file names them first.
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
    let missing: Vec<&str> =
        COLUMNS.into_iter().filter(|column| !head.iter().any(|name| name == *column)).collect();
    if !missing.is_empty() {
        return Err(PredictionsError::Columns { path: path.to_owned(), missing });
    }
    let mut trials: Vec<Trial> = Vec::new();
    let mut numbers: HashMap<[String; 2], usize> = HashMap::new();
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).map_err(broken)? {
        let line: Line = record.deserialize(Some(&head)).map_err(broken)?;
        let refused = |reason| {
            let line = record.position().map_or(0, csv::Position::line);
            PredictionsError::Class { path: path.to_owned(), line, reason }
        };
        let class = |name: &str| name.parse().map_err(refused);
        let (truth, predicted) = (class(line.truth)?, class(line.predicted)?);
        let scores = [line.score_negative, line.score_positive, line.score_surprise];
        let told = Prediction::class_of(&scores);
        if told != predicted {
            return Err(refused(format!(
                "predicted is {predicted}, but the largest score is that of {told}"
            )));
        }
        let number = *numbers.entry([line.set.to_owned(), line.method.to_owned()]).or_insert_with(|| {
            trials.push(Trial {
                method: line.method.to_owned(),
                set: line.set.to_owned(),
                predictions: Vec::new(),
            });
            trials.len() - 1
        });
        trials[number].predictions.push(Prediction {
            dataset: line.dataset.to_owned(),
            subject: line.subject.to_owned(),
            clip: line.clip.to_owned(),
            truth,
            epoch: line.epoch,
            predicted,
            scores,
        });
    }
    if trials.is_empty() { Err(PredictionsError::Empty { path: path.to_owned() }) } else { Ok(trials) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_equal_scores_wins() {
        assert_eq!(Prediction::class_of(&[0.5, 0.5, 0.1]), EmotionClass::Negative);
        assert_eq!(Prediction::class_of(&[0.5, 0.75, 0.75]), EmotionClass::Positive);
        assert_eq!(Prediction::class_of(&[-2.0, -1.0, -0.5]), EmotionClass::Surprise);
    }

    fn trial() -> Trial {
        let prediction = |clip: &str, scores: [f32; 3]| Prediction {
            dataset: "samm".into(),
            subject: "006".into(),
            clip: clip.into(),
            truth: EmotionClass::Positive,
            epoch: 20,
            predicted: Prediction::class_of(&scores),
            scores,
        };
        let predictions =
            vec![prediction("a, \"b\"", [0.1, -1e-30, 3.402_823_5e38]), prediction("c", [1.0; 3])];
        Trial { method: "tvl1".into(), set: "composite".into(), predictions }
    }

    #[test]
    fn a_file_gives_back_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("predictions.csv");
        let first = Trial { method: "zero".into(), ..trial() };
        write_predictions(&path, &[first.clone(), trial()]).unwrap();
        assert_eq!(read_predictions(&path).unwrap(), [first, trial()], "in the file's order");
    }

    #[test]
    fn other_files_are_refused_with_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("predictions.csv");
        write_predictions(&path, &[trial()]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("c,positive", "c,happy")).unwrap();
        let error = read_predictions(&path).unwrap_err().to_string();
        assert!(error.contains("line 3") && error.contains("happy"), "{error}");
        std::fs::write(&path, text.replace("c,positive,20,negative", "c,positive,20,surprise")).unwrap();
        let error = read_predictions(&path).unwrap_err().to_string();
        assert!(
            error.contains("line 3: predicted is surprise, but") && error.contains("negative"),
            "{error}"
        );
        std::fs::write(&path, text.replace("c,positive,20", "c,positive,twenty")).unwrap();
        let error = read_predictions(&path).unwrap_err().to_string();
        assert!(error.contains("line: 3"), "{error}");
        std::fs::write(&path, text.replace("truth", "class").replace("epoch", "step")).unwrap();
        let error = read_predictions(&path).unwrap_err().to_string();
        assert!(error.contains("no column truth, epoch;"), "{error}");
        for nothing in ["", text.lines().next().unwrap()] {
            std::fs::write(&path, nothing).unwrap();
            let error = read_predictions(&path).unwrap_err().to_string();
            assert!(error.contains("holds no predictions"), "{error}");
        }
        assert!(read_predictions(&folder.path().join("no.csv")).is_err());
    }
}
