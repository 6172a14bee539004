//! The log of a run: `log.jsonl`, one JSON object per line, and event files for TensorBoard.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_core::Metrics;
use srflow_eval::SCORES;
use srflow_files::{FileError, FileProblem, JsonLines, RunFolder};

use crate::tensorboard::EventFile;

/// One line of `log.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Record {
    Step(StepRecord),
    Skipped(SkippedRecord),
    Validation(ValidationRecord),
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepRecord {
    /// From 1.
    pub step: u64,
    /// From 1.
    pub epoch: u64,
    /// The minimised loss, averaged over the batch.
    pub loss: f64,
    /// Its parts, weighted, by name.
    pub parts: Vec<(String, f64)>,
    /// Mean end-point error of the last prediction, in pixels.
    pub epe: f64,
    pub learning_rate: f64,
    /// Norm of all gradients before clipping.
    pub gradient_norm: f64,
    /// Wall-clock seconds of the step, including waiting for data.
    pub seconds: f64,
    /// Seconds of them spent waiting for data.
    pub waited: f64,
}

/// A step that was skipped because the loss or the gradients were not finite.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkippedRecord {
    /// From 1.
    pub step: u64,
    /// The first frames of its batch.
    pub samples: Vec<String>,
}

/// The scores on one dataset, means over its pairs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValidationRecord {
    /// Steps done before.
    pub step: u64,
    pub dataset: String,
    pub pairs: usize,
    /// Over all pixels with a known flow.
    pub whole: Metrics,
    /// Over the pixels of the head, if the dataset has masks.
    pub head: Option<Metrics>,
    /// Mean end-point error of zero flow, in pixels.
    pub zero_epe: f64,
}

impl Record {
    pub fn step(&self) -> u64 {
        match self {
            Self::Step(record) => record.step,
            Self::Skipped(record) => record.step,
            Self::Validation(record) => record.step,
        }
    }

    /// Scalars with their tags for TensorBoard.
    fn tagged(&self) -> Vec<(String, f64)> {
        match self {
            Self::Step(record) => {
                let parts = record.parts.iter().map(|(name, value)| (format!("loss/{name}"), *value));
                let others = [
                    ("loss/total", record.loss),
                    ("train/epe", record.epe),
                    ("train/learning_rate", record.learning_rate),
                    ("train/gradient_norm", record.gradient_norm),
                    ("time/seconds_per_step", record.seconds),
                    ("time/waiting_share", record.waited / record.seconds.max(f64::MIN_POSITIVE)),
                ];
                parts.chain(others.map(|(tag, value)| (tag.to_owned(), value))).collect()
            }
            Self::Skipped(_) => vec![("train/skipped".to_owned(), 1.0)],
            Self::Validation(record) => {
                let of = |region: &'static str, metrics: &Metrics| {
                    let dataset = record.dataset.replace(", ", " ");
                    SCORES.map(|(name, .., value)| {
                        (format!("validation {dataset}/{name}{region}"), value(metrics))
                    })
                };
                let head = record.head.iter().flat_map(|head| of(" head", head));
                of("", &record.whole).into_iter().chain(head).collect()
            }
        }
    }
}

/// The log of a run, open for appending.
pub(crate) struct TrainingLog {
    run: PathBuf,
    log: JsonLines,
    events: EventFile,
}

/// Name of the folder of event files in a run's folder.
const EVENTS: &str = "tensorboard";

impl TrainingLog {
    /// Opens the log of a run, removing records after `step`, the step of the checkpoint to continue from.
    pub(crate) fn open(run: &RunFolder, step: u64) -> Result<Self, FileError> {
        let log = run.log(|record: &Record| record.step() <= step)?;
        let run = run.path().to_owned();
        let events = run.join(EVENTS);
        let created = EventFile::create(&events);
        let events =
            created.map_err(|error| FileProblem::Io { doing: "creating", error }.in_file(&events))?;
        Ok(Self { run, log, events })
    }

    /// Appends a record to the log and to the event file.
    pub(crate) fn write(&mut self, record: &Record) -> Result<(), FileError> {
        self.log.append(record)?;
        let written = self.events.write(record.step(), &record.tagged());
        written.map_err(|error| FileProblem::Io { doing: "writing the log", error }.in_file(&self.run))
    }
}

#[cfg(test)]
mod tests {
    use srflow_files::read_run_log;

    use super::*;

    fn step(step: u64) -> Record {
        Record::Step(StepRecord {
            step,
            epoch: 1,
            loss: 0.1 + 0.2,
            parts: vec![("sequence".to_owned(), 0.3)],
            epe: 1.5,
            learning_rate: 1e-4,
            gradient_norm: 2.0,
            seconds: 0.5,
            waited: 0.1,
        })
    }

    #[test]
    fn a_truncated_log_continues_from_the_checkpoint() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::open(dir.path()).unwrap();
        let mut log = TrainingLog::open(&run, 0).unwrap();
        (1..=5).for_each(|number| log.write(&step(number)).unwrap());
        drop(log);
        let path = run.path().join("log.jsonl");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 7]).unwrap();
        assert_eq!(read_run_log::<Record>(run.path()).unwrap().len(), 4);

        let mut log = TrainingLog::open(&run, 3).unwrap();
        log.write(&step(4)).unwrap();
        let skipped = Record::Skipped(SkippedRecord { step: 5, samples: vec!["a.png".to_owned()] });
        log.write(&skipped).unwrap();
        let expected: Vec<Record> = (1..=4).map(step).chain([skipped]).collect();
        assert_eq!(read_run_log::<Record>(run.path()).unwrap(), expected);
    }
}
