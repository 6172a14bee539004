//! The training loop, from the first step or the last checkpoint to the end of the run.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use burn::tensor::Device;
use srflow_field::{FileError, LockError, RunLock, create_folder, write_file};
use srflow_nets::about;
use srflow_nn::{AdamW, AdamWState, Rounding, WeightsError, clip_norm};

use crate::batch::Batch;
use crate::checkpoint::{Best, Checkpoint, CheckpointError, Checkpoints, Progress};
use crate::config::{Config, ConfigError};
use crate::loss::LossError;
use crate::prefetch::Prefetcher;
use crate::replica::{PassSettings, Replicas};
use crate::schedule::OneCycle;
use crate::training_log::{Record, SkippedRecord, StepRecord, TrainingLog, ValidationRecord};
use crate::training_set::{DataError, OpenMade, TrainingSample, TrainingSet};
use crate::validation::{Validation, ValidationError};

/// Name of the configuration in a run's folder.
const CONFIG: &str = "config.toml";

/// Errors that end a run, or keep it from starting.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("{0}")]
    Data(#[from] DataError),
    #[error("{0}")]
    Validation(#[from] ValidationError),
    #[error(transparent)]
    Weights(#[from] WeightsError),
    #[error(transparent)]
    Lock(#[from] LockError),
    #[error(transparent)]
    Loss(#[from] LossError),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    #[error(transparent)]
    File(#[from] FileError),
    #[error(
        "{0}: this folder already contains a run of {steps} steps; continue it with --resume {0}, or choose another --out",
        .folder.display()
    )]
    AnotherRun {
        folder: PathBuf,
        /// Step of its last checkpoint.
        steps: u64,
    },
    #[error(
        "the loss or its gradients were not finite in {in_a_row} consecutive steps; the last one, step {step}, had the pairs\n  \
         {samples}\n{last_checkpoint}. Check these pairs, or lower training.learning_rate"
    )]
    NotFinite {
        /// The last of these steps, counted from 1.
        step: u64,
        in_a_row: u64,
        /// The first frames of its batch.
        samples: String,
        /// A sentence that names the last checkpoint.
        last_checkpoint: String,
    },
    #[error("a thread that reads training pairs panicked; see its message above")]
    Worker,
}

/// Progress of [`train`].
#[derive(Debug)]
pub enum Event<'a> {
    Started(&'a Start),
    /// A step, taken or skipped, or a validation, in the order of the log.
    Recorded(&'a Record),
    /// A checkpoint was written.
    Saved {
        path: &'a Path,
        step: u64,
    },
}

/// Summary of a run when it starts or resumes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Start {
    /// Steps done before, 0 for a new run.
    pub done: u64,
    /// Steps of the whole run.
    pub steps: u64,
    pub steps_per_epoch: u64,
    /// The training data, one line per dataset.
    pub data: Vec<String>,
    /// The validation data, one line per dataset; empty without validation.
    pub validation: Vec<String>,
    /// Whether the network has batch norm with frozen running statistics.
    pub frozen_batch_norm: bool,
    /// Number of trained parameters, counted as scalars.
    pub parameters: usize,
}

/// The result of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    pub progress: Progress,
    /// Whether the run stopped on request before its last step.
    pub stopped: bool,
    /// Wall-clock seconds of this process, including validation and checkpoints.
    pub seconds: f64,
    /// Share of step time spent waiting for data, `0..=1`.
    pub waiting_share: f64,
}

/// Whether to start a new run or resume one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunMode {
    /// Start at step 0, in a folder without checkpoints.
    New,
    /// Continue from the last checkpoint in the folder.
    Resume,
}

/// The configuration of the run in the folder `run`, from its last checkpoint.
///
/// # Errors
/// When the folder has no checkpoint, or its last one is broken.
pub fn config_of_run(run: &Path) -> Result<Config, TrainError> {
    let text = Checkpoints::of_run(run).read_config()?;
    Ok(Config::parse(&text, &run.display().to_string())?)
}

/// Trains a network on `devices` in parallel, and writes `config.toml`, `log.jsonl`, `tensorboard/`, `checkpoints/`,
/// `last.safetensors` and, with validation data, `best.safetensors` into the folder `run`.
///
/// Data that is made while training is opened with `open_made`. With `stop_after`, training stops after that step and writes a checkpoint. For a given configuration and number of devices,
/// checkpoints have the same bytes whether the run was interrupted and resumed or not. `network.weights` is only read by new
/// runs.
///
/// # Errors
/// See [`TrainError`].
pub fn train(
    config: &Config,
    open_made: &OpenMade,
    devices: &[Device],
    run: &Path,
    mode: RunMode,
    stop_after: Option<u64>,
    on_event: &mut dyn FnMut(Event<'_>),
) -> Result<Outcome, TrainError> {
    let stop = |done| stop_after.is_some_and(|last| done >= last);
    train_until(config, open_made, devices, run, mode, &stop, on_event)
}

/// As [`train`], until `stop` says so: it is asked with the number of steps done, before the first step and after each. When it stops
/// after a step, a checkpoint is written.
///
/// # Errors
/// See [`TrainError`].
pub fn train_until(
    config: &Config,
    open_made: &OpenMade,
    devices: &[Device],
    run: &Path,
    mode: RunMode,
    stop: &dyn Fn(u64) -> bool,
    on_event: &mut dyn FnMut(Event<'_>),
) -> Result<Outcome, TrainError> {
    config.check()?;
    let start = Instant::now();
    let set = Arc::new(TrainingSet::open(config, open_made)?);
    let validation = Validation::open(config)?;
    let mut config = config.clone();
    let weights = match mode {
        RunMode::New => config.network.load_weights(&devices[0])?,
        RunMode::Resume => None,
    };
    let config = &config;
    let mut trainer = Trainer::new(config, devices, &set);
    let checkpoints = Checkpoints::of_run(run).about(about(&trainer.replicas.for_estimation()));
    if let Some(weights) = weights {
        trainer.fill(weights);
    }
    create_folder(run)?;
    let _lock = RunLock::take(run)?;
    match (mode, checkpoints.steps()?.last()) {
        (RunMode::New, None) => {}
        (RunMode::New, Some(&steps)) => {
            return Err(TrainError::AnotherRun { folder: run.to_owned(), steps });
        }
        (RunMode::Resume, _) => trainer.restore(checkpoints.read_last(trainer.replicas.layout())?),
    }
    checkpoints.remove_unfinished()?;
    let text = config.to_toml();
    write_file(&run.join(CONFIG), &text)?;
    let mut log = TrainingLog::open(run, trainer.progress.step)?;
    let mut record = |record: Record, on_event: &mut dyn FnMut(Event<'_>)| {
        let written = log.write(&record);
        on_event(Event::Recorded(&record));
        written
    };
    on_event(Event::Started(&trainer.start(config, &set, &validation)));

    let batch = config.training.batch;
    let mut prefetcher = prefetcher(&set, config, trainer.progress.step);
    let mut step_seconds = 0.0;
    let mut last = trainer.progress.step >= trainer.steps || stop(trainer.progress.step);
    while !last {
        let (began, waited_before) = (Instant::now(), prefetcher.waited());
        let clips: Vec<Vec<TrainingSample>> = (0..batch)
            .map(|_| prefetcher.take().ok_or(TrainError::Worker)?.map_err(Into::into))
            .collect::<Result<_, TrainError>>()?;
        let waited = (prefetcher.waited() - waited_before).as_secs_f64();
        let pairs = batches(&clips);
        let step = trainer.step(&pairs)?;
        let seconds = began.elapsed().as_secs_f64();
        step_seconds += seconds;
        match step {
            Some(step) => {
                record(Record::Step(StepRecord { seconds, waited, ..step }), on_event)?;
            }
            None => {
                let (step, in_a_row) = (trainer.progress.step, trainer.progress.skipped_in_a_row);
                let samples = pairs[0].names.clone();
                record(Record::Skipped(SkippedRecord { step, samples: samples.clone() }), on_event)?;
                if in_a_row >= config.training.bad_steps {
                    let samples = samples.join("\n  ");
                    let last_checkpoint = last_checkpoint_in_words(&checkpoints)?;
                    return Err(TrainError::NotFinite { step, in_a_row, samples, last_checkpoint });
                }
            }
        }
        let step = trainer.progress.step;
        let mut is_best = false;
        if !validation.is_empty() && trainer.due(config.validation.every) {
            is_best = trainer.validate(&validation, &checkpoints, &mut |scores| record(scores, on_event))?;
        }
        last = step == trainer.steps || stop(step);
        if is_best || last || trainer.due(config.checkpoints.every) {
            checkpoints.write(&trainer.checkpoint(&text), trainer.replicas.layout())?;
            checkpoints.prune(config.checkpoints.keep, trainer.progress.best.map(|best| best.step))?;
            on_event(Event::Saved { path: &checkpoints.path(step), step });
        }
    }
    Ok(Outcome {
        stopped: trainer.progress.step < trainer.steps,
        progress: trainer.progress,
        seconds: start.elapsed().as_secs_f64(),
        waiting_share: prefetcher.waited().as_secs_f64() / f64::max(step_seconds, f64::MIN_POSITIVE),
    })
}

fn prefetcher(
    set: &Arc<TrainingSet>,
    config: &Config,
    step: u64,
) -> Prefetcher<Result<Vec<TrainingSample>, DataError>> {
    let (set, batch) = (set.clone(), config.training.batch);
    let per_step = batch as u64;
    Prefetcher::new(step * per_step, config.data.workers, config.data.prefetch, move |number| {
        set.sample(number / per_step, (number % per_step) as usize, batch)
    })
}

/// The batches of the first pairs of all clips, of their second ones, and so on.
fn batches(clips: &[Vec<TrainingSample>]) -> Vec<Batch> {
    (0..clips[0].len()).map(|pair| Batch::new(clips.iter().map(|clip| &clip[pair]))).collect()
}

fn last_checkpoint_in_words(checkpoints: &Checkpoints) -> Result<String, CheckpointError> {
    Ok(match checkpoints.steps()?.last() {
        Some(&step) => format!("The last good checkpoint is {}", checkpoints.path(step).display()),
        None => "There is no checkpoint yet".to_owned(),
    })
}

/// The state of a run, and everything a step needs.
struct Trainer {
    replicas: Replicas,
    values: Vec<f32>,
    optimizer: AdamW,
    optimizer_state: AdamWState,
    schedule: OneCycle,
    clip: f64,
    progress: Progress,
    steps: u64,
    steps_per_epoch: u64,
    device: Device,
}

impl Trainer {
    fn new(config: &Config, devices: &[Device], set: &TrainingSet) -> Self {
        let training = &config.training;
        let settings = PassSettings {
            loss: config.loss.clone(),
            iterations: training.iterations,
            accumulate: training.accumulate,
            recompute: training.recompute,
        };
        let network = &config.network;
        let live = network.has_live_batch_norm();
        let init = |device: &Device| network.init(device);
        let (replicas, values) = Replicas::new(init, devices, training.seed, live, settings);
        let steps_per_epoch = set.steps_per_epoch(training.batch);
        let steps = match training.steps {
            0 => training.epochs.saturating_mul(steps_per_epoch),
            steps => steps,
        };
        Self {
            optimizer: AdamW {
                betas: training.betas,
                epsilon: training.epsilon,
                weight_decay: training.weight_decay,
                rounding: Rounding::Pytorch,
            },
            optimizer_state: AdamWState::new(values.len()),
            schedule: OneCycle {
                peak: training.learning_rate,
                total_steps: steps.saturating_add(training.extra_steps),
                rising: training.rising,
            },
            clip: training.clip,
            progress: Progress::default(),
            steps,
            steps_per_epoch,
            device: devices[0].clone(),
            replicas,
            values,
        }
    }

    fn start(&self, config: &Config, set: &TrainingSet, validation: &Validation) -> Start {
        // Only the running statistics of batch norm are not trained.
        let (trained, statistics): (Vec<_>, Vec<_>) =
            self.replicas.layout().segments().iter().partition(|segment| segment.trained);
        Start {
            validation: validation.describe(),
            frozen_batch_norm: !statistics.is_empty() && !config.network.has_live_batch_norm(),
            done: self.progress.step,
            steps: self.steps,
            steps_per_epoch: self.steps_per_epoch,
            data: set.describe(),
            parameters: trained.iter().map(|segment| segment.range.len()).sum(),
        }
    }

    fn fill(&mut self, values: Vec<f32>) {
        self.replicas.fill(&values);
        self.values = values;
    }

    fn restore(&mut self, checkpoint: Checkpoint) {
        self.fill(checkpoint.values);
        self.optimizer_state = checkpoint.optimizer;
        self.progress = checkpoint.progress;
    }

    fn checkpoint(&self, config: &str) -> Checkpoint {
        Checkpoint {
            progress: self.progress.clone(),
            config: config.to_owned(),
            values: self.values.clone(),
            optimizer: self.optimizer_state.clone(),
        }
    }

    /// Takes a step on clips, given by the [`batches`] of their pairs, or skips it (`None`) when its loss or gradients are not
    /// finite.
    fn step(&mut self, pairs: &[Batch]) -> Result<Option<StepRecord>, TrainError> {
        let learning_rate = self.schedule.learning_rate(self.progress.step);
        let mut pass = self.replicas.pass(pairs)?;
        let norm = clip_norm(&mut pass.gradients.values, self.clip);
        let step = self.progress.step + 1;
        let epoch = self.progress.step / self.steps_per_epoch + 1;
        self.progress.step = step;
        self.progress.epoch = step / self.steps_per_epoch;
        if !(pass.losses.is_finite() && norm.is_finite()) {
            self.progress.skipped += 1;
            self.progress.skipped_in_a_row += 1;
            self.replicas.fill(&self.values); // the pass may have updated running statistics
            return Ok(None);
        }
        self.progress.skipped_in_a_row = 0;
        self.replicas.collect_statistics(&mut self.values);
        let layout = self.replicas.layout();
        self.optimizer.step(
            layout,
            &mut self.values,
            &pass.gradients.values,
            &pass.gradients.reached,
            learning_rate,
            &mut self.optimizer_state,
        );
        self.progress.optimizer_steps = self.optimizer_state.steps;
        self.replicas.fill(&self.values);
        let parts = pass.losses.parts.iter().map(|&(name, value)| (name.to_owned(), value));
        Ok(Some(StepRecord {
            step,
            epoch,
            loss: pass.losses.total,
            parts: parts.collect(),
            epe: pass.losses.epe,
            learning_rate,
            gradient_norm: norm,
            seconds: 0.0,
            waited: 0.0,
        }))
    }

    /// Whether a task with an interval of `every` steps, 0 for an epoch, is due. After the last step it always is.
    fn due(&self, every: u64) -> bool {
        let every = if every == 0 { self.steps_per_epoch } else { every };
        self.progress.step.is_multiple_of(every) || self.progress.step == self.steps
    }

    /// Scores the network and, if it is the best so far, writes it. Returns whether it is.
    fn validate(
        &mut self,
        validation: &Validation,
        checkpoints: &Checkpoints,
        record: &mut dyn FnMut(Record) -> Result<(), FileError>,
    ) -> Result<bool, TrainError> {
        let scores = validation.score(self.replicas.for_estimation(), &self.device)?;
        let step = self.progress.step;
        let epe = scores.first().map(|scores| scores.whole.epe);
        for scores in scores {
            record(Record::Validation(ValidationRecord { step, ..scores }))?;
        }
        let (Some(epe), best) = (epe, self.progress.best) else { return Ok(false) };
        if best.is_some_and(|best| best.epe <= epe) {
            return Ok(false);
        }
        self.progress.best = Some(Best { step, epe });
        checkpoints.write_best(self.replicas.layout(), &self.values)?;
        Ok(true)
    }
}

#[cfg(test)]
mod tests;
