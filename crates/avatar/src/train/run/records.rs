//! The files of a run that are text: what it is made from, its log and its scores.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_files::{FileError, FileKind, FileProblem, parse_error_in_words, read_text, write_file};

use crate::capture::HeadRecord;
use crate::train::{SplitScore, StepReport, ViewScore};

/// What a run is made from: `run.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunRecord {
    /// Folder of the capture.
    pub data: PathBuf,
    pub head: HeadRecord,
}

impl RunRecord {
    /// Reads the record of the run in `dir`.
    ///
    /// # Errors
    /// When there is none, or it is malformed.
    pub(super) fn read(dir: &Path) -> Result<Self, FileError> {
        let path = dir.join(RUN_NAME);
        let text = read_text(&path, FileKind::Json).map_err(|error| {
            if !error.is_not_found() {
                return error;
            }
            let expected = "the folder of a run";
            FileProblem::field("folder", expected, format!("no {RUN_NAME}")).in_file(dir)
        })?;
        serde_json::from_str(&text).map_err(|error| {
            let expected = "data and head, as srflow writes them";
            FileProblem::field("run", expected, parse_error_in_words(&error)).in_file(&path)
        })
    }

    pub(super) fn write(&self, dir: &Path) -> Result<(), FileError> {
        write_file(&dir.join(RUN_NAME), json(self))
    }
}

/// Name of the record of a run.
pub const RUN_NAME: &str = "run.json";
/// Name of the scores.
pub(super) const SCORES_NAME: &str = "scores.json";

/// One line of `log.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum LogRecord {
    Iterations(IterationsRecord),
    Scores(ScoresRecord),
}

/// Means over the iterations since the last such record.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IterationsRecord {
    /// The last of them, from 1.
    pub iteration: u64,
    /// What is minimised: `(1 - w) L1 + w (1 - SSIM)` and the regularizers.
    pub loss: f64,
    pub l1: f64,
    pub ssim: f64,
    /// The regularizers of positions and scales, weighted.
    pub position: f64,
    pub scale: f64,
    /// After the last of them.
    pub gaussians: usize,
    /// Wall-clock seconds of all of them.
    pub seconds: f64,
}

/// Mean scores of held-out pictures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoresRecord {
    /// Iterations done before.
    pub iteration: u64,
    /// `val` or `test`.
    pub split: String,
    pub pictures: usize,
    /// See [`Score`](crate::train::Score); without a value where it is infinite.
    pub psnr: Option<f64>,
    pub psnr_channels: Option<f64>,
    pub ssim: f64,
}

impl LogRecord {
    pub fn iteration(&self) -> u64 {
        match self {
            Self::Iterations(record) => record.iteration,
            Self::Scores(record) => record.iteration,
        }
    }
}

impl From<(u64, &SplitScore)> for ScoresRecord {
    fn from((iteration, SplitScore { split, pictures, mean, .. }): (u64, &SplitScore)) -> Self {
        let finite = |ratio: f64| Some(ratio).filter(|ratio| ratio.is_finite());
        Self {
            iteration,
            split: split.to_string(),
            pictures: *pictures,
            psnr: finite(mean.psnr),
            psnr_channels: finite(mean.psnr_channels),
            ssim: mean.ssim,
        }
    }
}

/// Sums over the iterations since the last record.
#[derive(Debug, Default)]
pub(super) struct Window {
    sums: IterationsRecord,
    count: u64,
}

impl Window {
    pub fn add(&mut self, report: &StepReport, seconds: f64) {
        let StepReport { iteration, image, regularizers, .. } = report;
        let sums = &mut self.sums;
        sums.iteration = *iteration;
        sums.loss += loss(report);
        sums.l1 += image.l1;
        sums.ssim += image.ssim;
        sums.position += regularizers.position;
        sums.scale += regularizers.scale;
        sums.seconds += seconds;
        self.count += 1;
    }

    /// The record of these iterations; the next ones are added to an empty window.
    pub fn take(&mut self, gaussians: usize) -> IterationsRecord {
        let Self { sums, count } = std::mem::take(self);
        let mean = |sum: f64| sum / count.max(1) as f64;
        IterationsRecord {
            loss: mean(sums.loss),
            l1: mean(sums.l1),
            ssim: mean(sums.ssim),
            position: mean(sums.position),
            scale: mean(sums.scale),
            gaussians,
            ..sums
        }
    }
}

/// What an iteration minimises.
pub(super) fn loss(StepReport { image, regularizers, .. }: &StepReport) -> f64 {
    image.total + regularizers.position + regularizers.scale
}

/// Scores of all held-out pictures at the end of a run: `scores.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunScores {
    pub iteration: u64,
    pub gaussians: usize,
    /// `val` (the held-out camera) and `test` (the held-out timesteps), those that have pictures.
    pub splits: Vec<ScoredSplit>,
}

/// Scores of a split and of each of its pictures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScoredSplit {
    #[serde(flatten)]
    pub scores: SplitScore,
    /// In the order of the capture.
    pub views: Vec<ViewScore>,
}

impl RunScores {
    pub(super) fn write(&self, dir: &Path) -> Result<(), FileError> {
        write_file(&dir.join(SCORES_NAME), json(self))
    }
}

fn json(record: &impl Serialize) -> String {
    serde_json::to_string_pretty(record).expect("numbers and text") + "\n"
}
