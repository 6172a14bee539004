//! A training in a folder, from its first iteration or its last checkpoint to its scores:
//!
//! ```text
//! config.toml                 the configuration
//! run.json                    the capture and the head model
//! checkpoint.npz              the exact state, replaced every few minutes
//! preview.png                 a held-out picture beside its rendering, at the last checkpoint
//! log.jsonl                   losses, and scores of held-out pictures
//! point_cloud/iteration_N/    the avatar in the files of GaussianAvatars, ten times in a run
//! scores.json                 scores of every held-out picture, at the end
//! .lock                       the process that trains
//! ```

mod records;

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use srflow_core::Image;
use srflow_files::{
    FileError, FileKind, FileProblem, RUN_CONFIG, RunFolder, RunFolderError, RunMode, SettingsError,
    parse_settings, read_text, remove_partial, settings_text, write_image_png,
};

pub use records::{IterationsRecord, LogRecord, RUN_NAME, RunRecord, RunScores, ScoredSplit, ScoresRecord};
use records::{Window, loss};

use super::{SplitScore, StepReport, TrainConfig, TrainError, Trainer, ViewScore};
use crate::capture::{Capture, CaptureSplit, CaptureView, HeadRecord};
use srflow_head::HeadModel;

const CHECKPOINT_NAME: &str = "checkpoint.npz";
const PREVIEW_NAME: &str = "preview.png";

/// Errors that end a run, or keep it from starting.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    #[error(transparent)]
    Train(#[from] TrainError),
    #[error(transparent)]
    Settings(#[from] SettingsError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    /// A new run in a folder with other files.
    #[error("{}: expected a new or empty folder for the run, found {found:?} in it; choose another `out`", .folder.display())]
    Occupied { folder: PathBuf, found: String },
    #[error(
        "the loss was not finite in iteration {iteration}; the training is as far as iteration {checkpoint} in {}. Lower the rates, \
         such as rates.positions, or check the pictures and cameras", .folder.display()
    )]
    NotFinite {
        iteration: u64,
        folder: PathBuf,
        /// Iteration of its last checkpoint.
        checkpoint: u64,
    },
}

/// A run to do.
pub struct RunRequest<'a> {
    /// Folder of the run.
    pub dir: &'a Path,
    /// A run that was stopped before its first checkpoint resumes from the start.
    pub mode: RunMode,
    /// What `capture` and `model` were read from.
    pub record: RunRecord,
    pub capture: Capture,
    pub model: HeadModel,
    pub config: TrainConfig,
    /// Least time between checkpoints.
    pub checkpoint_interval: Duration,
    /// Whether to stop, with a checkpoint: asked with the number of iterations done, at the start and after each line of the log.
    pub stop: &'a dyn Fn(u64) -> bool,
}

/// Progress of [`run`].
#[derive(Debug)]
pub enum RunEvent<'a> {
    /// The training is about to start, after the iterations that are done.
    Started {
        trainer: &'a Trainer,
        /// Of the whole run.
        iterations: u64,
    },
    Stepped(&'a StepReport),
    /// A line of the log was written.
    Recorded(&'a LogRecord),
    /// A checkpoint was written, and the preview.
    Saved {
        iteration: u64,
    },
    /// A held-out picture was scored.
    Scored {
        split: CaptureSplit,
        done: usize,
        pictures: usize,
    },
}

/// The result of a run.
#[derive(Debug)]
pub struct RunOutcome {
    pub config: TrainConfig,
    pub trainer: Trainer,
    /// `None` if it stopped on request before its end.
    pub scores: Option<RunScores>,
    /// The folder of the avatar, if there are scores.
    pub avatar: PathBuf,
    /// Wall-clock seconds of this process.
    pub seconds: f64,
}

/// What the run in `dir` is made from, and its configuration.
///
/// # Errors
/// When `dir` is no folder of a run, or its files are malformed.
pub fn read_run(dir: &Path) -> Result<(RunRecord, TrainConfig), RunError> {
    let record = RunRecord::read(dir)?;
    let path = dir.join(RUN_CONFIG);
    let text = read_text(&path, FileKind::Settings)?;
    Ok((record, parse_settings(&text, &path.display().to_string())?))
}

/// The folder of the run that wrote the avatar in `dir`, which is `point_cloud/iteration_N` in it; `None` for other avatars.
pub fn run_of_avatar(dir: &Path) -> Option<&Path> {
    dir.ancestors().nth(2).filter(|run| run.join(RUN_NAME).is_file())
}

/// Trains an avatar and scores it; see the list of files above. For a given configuration and capture, the avatar and the scores
/// have the same bytes whether the run was interrupted and resumed or not.
///
/// # Errors
/// See [`RunError`].
pub fn run(request: RunRequest, on_event: &mut dyn FnMut(RunEvent)) -> Result<RunOutcome, RunError> {
    let RunRequest { dir, mode, record, capture, model, config, checkpoint_interval, stop } = request;
    let start = Instant::now();
    let checkpoint = dir.join(CHECKPOINT_NAME);
    if mode == RunMode::New {
        check_place(dir)?;
    }
    let mut trainer = match mode {
        RunMode::Resume if checkpoint.exists() => Trainer::resume(capture, model, config, &checkpoint)?,
        RunMode::Resume | RunMode::New => Trainer::new(capture, model, config)?,
    };
    let folder = RunFolder::open(dir)?;
    folder.write_config(&settings_text(&config))?;
    record.write(dir)?; // last: a folder with it can be resumed
    let done = trainer.iteration();
    let mut log = folder.log(|record: &LogRecord| record.iteration() <= done)?;
    on_event(RunEvent::Started { trainer: &trainer, iterations: config.iterations });

    let intervals = Intervals::of(config.iterations);
    let avatar = |iteration: u64| dir.join(format!("point_cloud/iteration_{iteration}"));
    let (mut saved, mut saved_iteration) = (Instant::now(), done);
    let mut window = Window::default();
    let mut last = done >= config.iterations || stop(done);
    while !last {
        let began = Instant::now();
        let report = trainer.step()?;
        let iteration = report.iteration;
        if !loss(&report).is_finite() {
            return Err(RunError::NotFinite {
                iteration,
                folder: dir.to_owned(),
                checkpoint: saved_iteration,
            });
        }
        window.add(&report, began.elapsed().as_secs_f64());
        on_event(RunEvent::Stepped(&report));
        if !iteration.is_multiple_of(intervals.log) && iteration != config.iterations {
            continue;
        }
        let mut append = |record: LogRecord, on_event: &mut dyn FnMut(RunEvent)| {
            log.append(&record)?;
            on_event(RunEvent::Recorded(&record));
            Ok::<(), FileError>(())
        };
        append(LogRecord::Iterations(window.take(trainer.avatar().bound().len())), on_event)?;
        // The scores after the last iteration are those of the run.
        if intervals.scores(iteration) && iteration + intervals.score <= config.iterations {
            let split = held_out(trainer.capture());
            if let Some(ScoredSplit { scores, .. }) = score(&mut trainer, split, on_event)? {
                append(LogRecord::Scores((iteration, &scores).into()), on_event)?;
            }
            write_avatar(&trainer, &avatar(iteration), &record.head)?;
        }
        last = iteration == config.iterations || stop(iteration);
        if last || saved.elapsed() >= checkpoint_interval {
            trainer.write_checkpoint(&checkpoint)?;
            preview(&trainer, &dir.join(PREVIEW_NAME))?;
            (saved, saved_iteration) = (Instant::now(), iteration);
            on_event(RunEvent::Saved { iteration });
        }
    }
    let avatar = avatar(config.iterations);
    let scores = if trainer.iteration() < config.iterations {
        None
    } else {
        write_avatar(&trainer, &avatar, &record.head)?;
        let mut splits = Vec::new();
        for split in [CaptureSplit::Val, CaptureSplit::Test] {
            splits.extend(score(&mut trainer, split, on_event)?);
        }
        let gaussians = trainer.avatar().bound().len();
        let scores = RunScores { iteration: config.iterations, gaussians, splits };
        scores.write(dir)?;
        Some(scores)
    };
    Ok(RunOutcome { config, trainer, scores, avatar, seconds: start.elapsed().as_secs_f64() })
}

/// Numbers of iterations between what a run does now and then.
struct Intervals {
    /// A line of the log; a checkpoint comes after a line.
    log: u64,
    /// Scores of held-out pictures and the files of the avatar.
    score: u64,
}

impl Intervals {
    fn of(iterations: u64) -> Self {
        let log = (iterations / 3000).clamp(1, 100);
        Self { log, score: iterations.div_ceil(10).next_multiple_of(log) }
    }

    /// In the middle of each interval: at round numbers of iterations opacities are reset.
    fn scores(&self, iteration: u64) -> bool {
        let middle = self.score / 2 / self.log * self.log;
        iteration % self.score == middle
    }
}

/// Fails for a new run where another one is, or other files are.
fn check_place(dir: &Path) -> Result<(), RunError> {
    if dir.join(RUN_NAME).exists() {
        return Err(RunFolderError::AnotherRun { folder: dir.to_owned(), steps: None }.into());
    }
    let failed = |error| FileProblem::Io { doing: "listing the folder", error }.in_file(dir);
    let entries = match fs::read_dir(dir) {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => return Ok(()),
        entries => entries.map_err(failed)?,
    };
    for entry in entries {
        let found = entry.map_err(failed)?.file_name().to_string_lossy().into_owned();
        // A run that was stopped before it began leaves these.
        if found != RUN_CONFIG && !found.starts_with('.') {
            return Err(RunError::Occupied { folder: dir.to_owned(), found });
        }
    }
    Ok(())
}

/// Writes the avatar, without what a run left there that was killed as it wrote the same.
fn write_avatar(trainer: &Trainer, dir: &Path, head: &HeadRecord) -> Result<(), FileError> {
    trainer.write_avatar(dir, Some(head))?;
    remove_partial(dir, |_, _| true)
}

/// The split that is scored during a run: a camera that is held out, or else timesteps.
fn held_out(capture: &Capture) -> CaptureSplit {
    match capture.of(CaptureSplit::Val).next() {
        Some(_) => CaptureSplit::Val,
        None => CaptureSplit::Test,
    }
}

/// The scores of a split and of each of its pictures; `None` without one.
fn score(
    trainer: &mut Trainer,
    split: CaptureSplit,
    on_event: &mut dyn FnMut(RunEvent),
) -> Result<Option<ScoredSplit>, RunError> {
    let pictures = trainer.capture().of(split).count();
    let mut views = Vec::with_capacity(pictures);
    trainer.score(split, |view, score| {
        views.push(ViewScore::new(view, *score));
        on_event(RunEvent::Scored { split, done: views.len(), pictures });
    })?;
    Ok(SplitScore::of(split, &views).map(|scores| ScoredSplit { scores, views }))
}

/// Writes a held-out picture beside its rendering.
fn preview(trainer: &Trainer, path: &Path) -> Result<(), RunError> {
    let capture = trainer.capture();
    let views = |split| capture.of(split).collect::<Vec<&CaptureView>>();
    let [held_out, training] = [held_out(capture), CaptureSplit::Train].map(views);
    let views = if held_out.is_empty() { training } else { held_out };
    let Some(view) = views.get(views.len() / 2) else { return Ok(()) };
    Ok(write_image_png(path, &Image::beside(&trainer.truth_and_rendering(view)?))?)
}
