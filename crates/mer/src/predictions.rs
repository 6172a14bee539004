//! What classifiers said, clip by clip, and the file that keeps it: every number of the results follows from it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::EmotionClass;
use srflow_field::{FileError, write_atomically};

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
    /// It is no CSV file, or a line lacks a column or holds something else in it.
    #[error("{}: {source}; expected a predictions.csv as `srflow mer run` writes it", .path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// What is wrong, and in which line.
        source: csv::Error,
    },
    /// A class of another name.
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

/// Reads what [`write_predictions`] wrote; trials by set, then method.
///
/// # Errors
/// When the file cannot be read or holds something else.
pub fn read_predictions(path: &Path) -> Result<Vec<Trial>, PredictionsError> {
    let broken = |source| PredictionsError::Csv { path: path.to_owned(), source };
    let mut reader = csv::Reader::from_path(path).map_err(broken)?;
    let head = reader.headers().map_err(broken)?.clone();
    let mut trials: BTreeMap<(String, String), Vec<Prediction>> = BTreeMap::new();
    let mut record = csv::StringRecord::new();
    while reader.read_record(&mut record).map_err(broken)? {
        let line: Line = record.deserialize(Some(&head)).map_err(broken)?;
        let class = |name: &str| {
            let number = record.position().map_or(0, csv::Position::line);
            name.parse().map_err(|reason| PredictionsError::Class {
                path: path.to_owned(),
                line: number,
                reason,
            })
        };
        trials.entry((line.set.to_owned(), line.method.to_owned())).or_default().push(Prediction {
            dataset: line.dataset.to_owned(),
            subject: line.subject.to_owned(),
            clip: line.clip.to_owned(),
            truth: class(line.truth)?,
            epoch: line.epoch,
            predicted: class(line.predicted)?,
            scores: [line.score_negative, line.score_positive, line.score_surprise],
        });
    }
    let trial = |((set, method), predictions)| Trial { method, set, predictions };
    Ok(trials.into_iter().map(trial).collect())
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
        write_predictions(&path, &[trial()]).unwrap();
        assert_eq!(read_predictions(&path).unwrap(), [trial()]);
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
        std::fs::write(&path, "a,b\n1,2\n").unwrap();
        let error = read_predictions(&path).unwrap_err().to_string();
        assert!(error.contains("missing field `method`"), "{error}");
        assert!(read_predictions(&folder.path().join("no.csv")).is_err());
    }
}
