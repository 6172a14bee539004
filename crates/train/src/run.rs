//! The training loop, from the first step or the last checkpoint to the end of the run.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use srflow_core::excerpt;
use srflow_files::{
    FileError, FileKind, FileProblem, RUN_CONFIG, RunFolder, RunFolderError, RunMode, read_text,
};
use srflow_nets::about;
use srflow_nn::{AdamW, AdamWState, Rounding, clip_norm};
use srflow_ops::check_precision;

use crate::batch::Batch;
use crate::checkpoint::{Best, Checkpoint, CheckpointError, Checkpoints, Progress};
use crate::config::Config;
use crate::data_error::DataError;
use crate::error::TrainError;
use crate::made::OpenMade;
use crate::pass::{BatchLosses, Pass, PassSettings};
use crate::prefetch::Prefetcher;
use crate::ranks::{Alone, Communicator, Ranks, share};
use crate::replica::Replicas;
use crate::schedule::OneCycle;
use crate::training_log::{Record, SkippedRecord, StepRecord, TrainingLog, ValidationRecord};
use crate::training_set::{TrainingSample, TrainingSet};
use crate::validation::Validation;

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
    /// Processes that train together.
    pub ranks: usize,
    /// How many there were before the run was resumed, if another number: its weights then differ in rounding from those of an
    /// uninterrupted run.
    pub ranks_before: Option<usize>,
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
    /// Share of the time from the first step on that this rank has spent waiting for others, `0..=1`.
    pub waiting_for_ranks_share: f64,
    /// Share of that time spent summing the gradients of ranks, `0..=1`.
    pub summing_share: f64,
    /// Processes that trained together.
    pub ranks: usize,
}

/// The configuration of the run in the folder `run`, from its last checkpoint.
///
/// # Errors
/// When the folder has no checkpoint, its last one is broken, or its `config.toml` was edited: a run keeps its configuration.
pub fn config_of_run(run: &Path) -> Result<Config, TrainError> {
    let text = Checkpoints::of_run(run).read_config()?;
    let config = recorded(&text, run)?;
    let path = run.join(RUN_CONFIG);
    if path.exists() {
        let edited = read_text(&path, FileKind::Settings)?;
        if edited != text && recorded(&edited, &path)? != config {
            let differing = edited.lines().zip(text.lines()).find(|(edited, text)| edited != text);
            let (found, expected) = differing.unwrap_or(("another number of lines", "the same lines"));
            let expected = format!(
                "{} as the run was started; undo the change, or start a new run with this file as `config`",
                excerpt(expected)
            );
            return Err(FileProblem::field("the configuration", expected, excerpt(found))
                .in_file(&path)
                .into());
        }
    }
    Ok(config)
}

/// A configuration as a run records it. Runs of before rendered heads had several looks name none, and see the first.
fn recorded(text: &str, file: &Path) -> Result<Config, TrainError> {
    let mut config = Config::parse(text, &file.display().to_string())?;
    if !text.lines().any(|line| line.starts_with("look =")) {
        config.data.rendered.settings.insert("look".to_owned(), 1.into());
    }
    Ok(config)
}

/// A training: of what, on what, and where to.
#[derive(Clone, Copy)]
pub struct Training<'a> {
    pub config: &'a Config,
    /// Opens data that is made while training.
    pub open_made: &'a OpenMade<'a>,
    /// Devices that share each batch.
    pub devices: &'a [Device],
    /// Folder of the run.
    pub run: &'a Path,
    pub mode: RunMode,
    /// The processes that share each batch before the devices do.
    pub communicator: &'a dyn Communicator,
}

/// Trains a network on `devices` in parallel, in this process alone; see [`Training::until`].
///
/// # Errors
/// See [`TrainError`].
pub fn train(
    config: &Config,
    open_made: &OpenMade,
    devices: &[Device],
    run: &Path,
    mode: RunMode,
    on_event: &mut dyn FnMut(Event<'_>),
) -> Result<Outcome, TrainError> {
    Training { config, open_made, devices, run, mode, communicator: &Alone }.until(&|_| false, on_event)
}

impl Training<'_> {
    /// Trains, and writes `config.toml`, `log.jsonl`, `tensorboard/`, `checkpoints/`, `last.safetensors` and, with validation data,
    /// `best.safetensors` into the folder of the run. It ends early when `stop` says so, which is asked with the number of steps done,
    /// before the first step and after each; when it stops after a step, a checkpoint is written.
    ///
    /// For a given configuration and number of ranks and devices, checkpoints have the same bytes whether the run was interrupted and
    /// resumed or not. `network.weights` is only read by new runs. All ranks read the folder of the run; the first one writes and
    /// reports events. A rank that fails, or is asked to stop, ends all of them.
    ///
    /// # Errors
    /// See [`TrainError`].
    pub fn until(
        &self,
        stop: &dyn Fn(u64) -> bool,
        on_event: &mut dyn FnMut(Event<'_>),
    ) -> Result<Outcome, TrainError> {
        let ranks = Ranks::new(self.communicator);
        ranks.end(self.train(&ranks, stop, on_event))
    }

    fn train(
        &self,
        ranks: &Ranks,
        stop: &dyn Fn(u64) -> bool,
        on_event: &mut dyn FnMut(Event<'_>),
    ) -> Result<Outcome, TrainError> {
        let Self { devices, run, mode, .. } = *self;
        let mut config = self.config.clone();
        config.check()?;
        let batch = config.training.batch;
        if batch < ranks.count() {
            return Err(TrainError::TooManyRanks { batch, ranks: ranks.count() });
        }
        for device in devices {
            check_precision(device, config.training.precision)?;
        }
        let start = Instant::now();
        let set = Arc::new(TrainingSet::open(&config, self.open_made)?);
        let validation = if ranks.leads() { Validation::open(&config)? } else { Validation::none(&config) };
        let weights = match mode {
            RunMode::New => config.network.load_weights(&devices[0])?,
            RunMode::Resume => None,
        };
        let config = &config;
        let mut trainer = Trainer::new(config, devices, &set, ranks.count());
        let checkpoints = Checkpoints::of_run(run).about(about(&trainer.replicas.for_estimation()));
        if let Some(weights) = weights {
            trainer.fill(weights);
        }
        let folder = if ranks.leads() { Some(RunFolder::open(run)?) } else { None };
        match (mode, checkpoints.steps()?.last()) {
            (RunMode::New, None) => {}
            (RunMode::New, Some(&steps)) => {
                return Err(RunFolderError::AnotherRun { folder: run.to_owned(), steps: Some(steps) }.into());
            }
            (RunMode::Resume, _) => trainer.restore(checkpoints.read_last(trainer.replicas.layout())?),
        }
        let text = config.to_toml();
        ranks.same("the configurations", || hash(&text))?;
        ranks.same("the training data", || hash(&set.describe()))?;
        ranks.same("the steps", || trainer.progress.step)?;
        ranks.same("the weights", || trainer.hash())?;
        let mut log = match &folder {
            Some(folder) => {
                checkpoints.remove_unfinished()?;
                folder.write_config(&text)?;
                Some(TrainingLog::open(folder, trainer.progress.step)?)
            }
            None => None,
        };
        let mut record = |record: Record, on_event: &mut dyn FnMut(Event<'_>)| {
            let Some(log) = &mut log else { return Ok(()) };
            let written = log.write(&record);
            on_event(Event::Recorded(&record));
            written
        };
        if ranks.leads() {
            on_event(Event::Started(&trainer.start(config, &set, &validation)));
        }

        let share = share(ranks.rank(), ranks.count(), batch);
        let mut prefetcher = prefetcher(&set, config, share.clone(), trainer.progress.step);
        let mut step_seconds = 0.0;
        let training = Instant::now();
        // What the weights were before is the score to beat, and the best so far.
        if trainer.progress.step == 0
            && !config.network.weights.as_os_str().is_empty()
            && !validation.is_empty()
        {
            trainer.validate(&validation, &checkpoints, &mut |scores| record(scores, on_event))?;
        }
        let mut last = trainer.progress.step >= trainer.steps || any(ranks, stop(trainer.progress.step))?;
        while !last {
            let (began, waited_before) = (Instant::now(), prefetcher.waited());
            let clips: Vec<Vec<TrainingSample>> = share
                .clone()
                .map(|_| prefetcher.take().ok_or(TrainError::Worker)?.map_err(Into::into))
                .collect::<Result<_, TrainError>>()?;
            let waited = (prefetcher.waited() - waited_before).as_secs_f64();
            let pairs = batches(&clips);
            let step = trainer.step(&pairs, ranks)?;
            let seconds = began.elapsed().as_secs_f64();
            step_seconds += seconds;
            match step {
                Some(step) => {
                    record(Record::Step(StepRecord { seconds, waited, ..step }), on_event)?;
                }
                None => {
                    let (step, in_a_row) = (trainer.progress.step, trainer.progress.skipped_in_a_row);
                    let samples = ranks.agree(Ok(pairs[0].names.clone()))?.concat();
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
                is_best =
                    trainer.validate(&validation, &checkpoints, &mut |scores| record(scores, on_event))?;
            }
            last = any(ranks, stop(step))? || step == trainer.steps;
            let regular = last || trainer.due(config.checkpoints.every);
            if regular {
                ranks.same("the weights", || trainer.hash())?;
            }
            if ranks.leads() && (is_best || regular) {
                checkpoints.write(&trainer.checkpoint(&text), trainer.replicas.layout())?;
                checkpoints.prune(config.checkpoints.keep, trainer.progress.best.map(|best| best.step))?;
                on_event(Event::Saved { path: &checkpoints.path(step), step });
            }
        }
        let of_all =
            |time: Duration| time.as_secs_f64() / training.elapsed().as_secs_f64().max(f64::MIN_POSITIVE);
        Ok(Outcome {
            stopped: trainer.progress.step < trainer.steps,
            progress: trainer.progress,
            seconds: start.elapsed().as_secs_f64(),
            waiting_share: prefetcher.waited().as_secs_f64() / f64::max(step_seconds, f64::MIN_POSITIVE),
            waiting_for_ranks_share: of_all(ranks.times().waiting),
            summing_share: of_all(ranks.times().summing),
            ranks: ranks.count(),
        })
    }
}

/// Whether it is so for any rank.
fn any(ranks: &Ranks, so: bool) -> Result<bool, TrainError> {
    Ok(ranks.agree(Ok(so))?.contains(&true))
}

/// For comparisons between processes of one program.
fn hash(value: &impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}

/// Loads the samples at the places `share` of each batch.
fn prefetcher(
    set: &Arc<TrainingSet>,
    config: &Config,
    share: Range<usize>,
    step: u64,
) -> Prefetcher<Result<Vec<TrainingSample>, DataError>> {
    let (set, batch) = (set.clone(), config.training.batch);
    let per_step = share.len() as u64;
    Prefetcher::new(step * per_step, config.data.workers, config.data.prefetch, move |number| {
        set.sample(number / per_step, share.start + (number % per_step) as usize, batch)
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
    live_batch_norm: bool,
    /// Processes that train together.
    ranks: usize,
    /// How many there were before the run was resumed.
    ranks_before: usize,
}

impl Trainer {
    fn new(config: &Config, devices: &[Device], set: &TrainingSet, ranks: usize) -> Self {
        let training = &config.training;
        let settings = PassSettings {
            loss: config.loss.clone(),
            iterations: training.iterations,
            starts: training.starts,
            accumulate: training.accumulate,
            recompute: training.recompute,
            precision: training.precision,
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
            live_batch_norm: live,
            ranks,
            ranks_before: ranks,
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
            ranks: self.ranks,
            ranks_before: Some(self.ranks_before).filter(|before| *before != self.ranks),
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
        self.ranks_before = checkpoint.ranks;
    }

    fn checkpoint(&self, config: &str) -> Checkpoint {
        Checkpoint {
            progress: self.progress.clone(),
            config: config.to_owned(),
            values: self.values.clone(),
            optimizer: self.optimizer_state.clone(),
            ranks: self.ranks,
        }
    }

    /// Of the parameters and the optimizer's state.
    fn hash(&self) -> u64 {
        let AdamWState { steps, mean, square } = &self.optimizer_state;
        hash(&(*steps, [&self.values, mean, square].map(|values| bytemuck::cast_slice::<f32, u8>(values))))
    }

    /// Takes a step on clips, given by the [`batches`] of their pairs in this rank, or skips it (`None`) when the loss or gradients of
    /// any rank are not finite.
    fn step(&mut self, pairs: &[Batch], ranks: &Ranks) -> Result<Option<StepRecord>, TrainError> {
        let learning_rate = self.schedule.learning_rate(self.progress.step);
        let mut pass = sum(ranks, self.replicas.pass(pairs)?, pairs[0].len())?;
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
        if self.live_batch_norm {
            self.average_statistics(ranks)?;
        }
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

    /// Averages the running statistics of batch norm over the ranks.
    fn average_statistics(&mut self, ranks: &Ranks) -> Result<(), TrainError> {
        let untrained = self.replicas.layout().segments().iter().filter(|segment| !segment.trained);
        let places: Vec<usize> = untrained.flat_map(|segment| segment.range.clone()).collect();
        let mut statistics: Vec<f32> = places.iter().map(|&place| self.values[place]).collect();
        ranks.agree(Ok(()))?;
        ranks.sum(&mut statistics);
        for (place, sum) in places.into_iter().zip(statistics) {
            self.values[place] = sum / ranks.count() as f32;
        }
        Ok(())
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

/// What a rank says of its pass over `samples` samples. Losses are bits: they may not be finite.
#[derive(Serialize, Deserialize)]
struct PassReport {
    samples: usize,
    total: u64,
    parts: Vec<u64>,
    epe: u64,
    /// Of the gradients.
    reached: Vec<bool>,
}

/// The pass over the whole batch, from each rank's over its samples.
fn sum(ranks: &Ranks, mut pass: Pass, samples: usize) -> Result<Pass, TrainError> {
    if ranks.count() == 1 {
        return Ok(pass);
    }
    let BatchLosses { total, parts, epe } = &pass.losses;
    let reports = ranks.agree(Ok(PassReport {
        samples,
        total: total.to_bits(),
        parts: parts.iter().map(|(_, value)| value.to_bits()).collect(),
        epe: epe.to_bits(),
        reached: pass.gradients.reached.clone(),
    }))?;
    let all: usize = reports.iter().map(|report| report.samples).sum();
    let weight = |samples: usize| samples as f64 / all as f64;
    for gradient in &mut pass.gradients.values {
        *gradient *= weight(samples) as f32;
    }
    ranks.sum(&mut pass.gradients.values);
    let mut losses = BatchLosses::default();
    for report in reports {
        let names = pass.losses.parts.iter().map(|&(name, _)| name);
        let parts = names.zip(report.parts.into_iter().map(f64::from_bits)).collect();
        let (total, epe) = (f64::from_bits(report.total), f64::from_bits(report.epe));
        losses.add(&BatchLosses { total, parts, epe }, weight(report.samples));
        for (reached, other) in pass.gradients.reached.iter_mut().zip(report.reached) {
            *reached |= other;
        }
    }
    Ok(Pass { losses, ..pass })
}

#[cfg(test)]
mod tests;
