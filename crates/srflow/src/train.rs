//! Training an optical flow network.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use srflow_core::Size;
use srflow_files::{Preset, RunMode, read_run_log, write_file};
use srflow_ops::device;
use srflow_train::checkpoint::Best;
use srflow_train::config::{Config, PRESETS};
use srflow_train::ranks::{Alone, Communicator};
use srflow_train::training_log::{Record, StepRecord};
use srflow_train::{Event, Outcome, Start, Training, config_of_run, report};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::made::{check_made, open_made};
use crate::networks::{note_if_ambiguous, weights_file};
use crate::output::write_line;
use crate::watch::Progress;
use crate::{Job, Report, Watch, WhenStopped, machine};

/// Train an optical flow network
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(after_help = "\
Examples:
  srflow train --config cpu-small --data srflow:DIR --out runs/first
  srflow train --config srflownet-fdr --data srflow:DIR --out runs/fdr --device cuda:0 --device cuda:1
  srflow train --config skflow --data folder:DIR --crop 384x512 --batch 4 --weights skflow.pth --out runs/mine
  srflow train --config skflow --set training.weight_decay=1e-5 --print-config
  srflow train --config cpu-small --data shapes: --data rendered:*2 --out runs/made
  srflow train --resume runs/first
  mpirun -n 4 srflow train --mpi --config skflow --data srflow:DIR --batch 8 --out runs/nodes

docs/guides/train.md is the guide; docs/reference/configuration.md lists the keys.")]
pub struct TrainJob {
    /// Preset or TOML file to start from [default: the paper's retrained SKFlow]
    #[arg(long, value_name = "PRESET|FILE", help = config_help())]
    pub config: Option<PathBuf>,
    /// Folder of the run
    #[arg(long, value_name = "DIR", required_unless_present_any = ["resume", "print_config"])]
    pub out: Option<PathBuf>,
    /// Continue the run in this folder from its last checkpoint
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "config"])]
    pub resume: Option<PathBuf>,
    /// Print the configuration with every key instead of training, as TOML or JSON
    #[arg(long)]
    pub print_config: bool,
    /// Write a checkpoint and stop after this step; `resume` continues
    #[arg(long, value_name = "N")]
    pub stop_after_step: Option<u64>,
    /// Device to train on; several devices share each batch
    #[arg(long, value_name = "DEVICE", default_values_t = default_device())]
    pub device: Vec<String>,
    /// Share every batch with the other processes of `mpirun` or `srun`
    #[arg(long)]
    pub mpi: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub overrides: Overrides,
}

/// Keys of the configuration as settings of the job; `set` reaches all keys.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(next_help_heading = "Overriding the configuration")]
pub struct Overrides {
    /// Training dataset, KIND:DIR or KIND:DIR*TIMES; several are mixed; `shapes:` and `rendered:` generate
    /// pairs during training
    #[arg(long, value_name = "KIND:DIR")]
    pub data: Vec<String>,
    /// Validation dataset [default: the val split of the training data]
    #[arg(long, value_name = "KIND:DIR")]
    pub validation: Vec<String>,
    /// Network
    #[arg(long, value_name = "NAME")]
    pub network: Option<String>,
    /// Initial weights: a file, or the name of published weights, such as things
    #[arg(long, value_name = "FILE|NAME")]
    pub weights: Option<String>,
    /// Number of steps; overrides the epochs
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Epochs
    #[arg(long, value_name = "N")]
    pub epochs: Option<u64>,
    /// Batch size in pairs
    #[arg(long, value_name = "N")]
    pub batch: Option<usize>,
    /// Crop size
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    pub crop: Option<Size>,
    /// Refinement iterations of the network
    #[arg(long, value_name = "N")]
    pub iterations: Option<usize>,
    /// Peak learning rate
    #[arg(long, value_name = "RATE")]
    pub learning_rate: Option<f64>,
    /// Random seed
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Any key of the configuration, e.g. training.clip=0.5 or loss.fdr=0.05
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    #[serde(deserialize_with = "crate::assignments::deserialize")]
    pub set: Vec<String>,
}

fn config_help() -> String {
    format!("Preset ({}) or TOML file [default: skflow]", Preset::names(PRESETS))
}

impl Overrides {
    /// The preset or TOML file `name`, or the default configuration, with these settings.
    ///
    /// # Errors
    /// When there is no such file, a key is unknown, or a value does not fit its key.
    pub fn configuration(&self, name: Option<&Path>) -> anyhow::Result<Config> {
        let config = self.apply(name.map(Config::read).transpose()?.unwrap_or_default())?;
        check_made(&config).map_err(anyhow::Error::msg)?;
        Ok(config)
    }

    fn apply(&self, mut config: Config) -> anyhow::Result<Config> {
        for (key, sources) in [("data.train", &self.data), ("validation.data", &self.validation)] {
            if !sources.is_empty() {
                let list = serde_json::to_string(sources)?; // a list of strings is the same in TOML
                config = config.with_override(&format!("{key}={list}"))?;
            }
        }
        let single = [
            ("network.architecture", text(&self.network)),
            ("network.weights", text(&self.weights)),
            ("training.steps", text(&self.steps)),
            ("training.epochs", text(&self.epochs)),
            ("training.batch", text(&self.batch)),
            ("data.crop", text(&self.crop)),
            ("training.iterations", text(&self.iterations)),
            ("training.learning_rate", text(&self.learning_rate)),
            ("training.seed", text(&self.seed)),
        ];
        for (key, value) in single {
            if let Some(value) = value {
                config = config.with_override(&format!("{key}={value}"))?;
            }
        }
        if self.epochs.is_some() && self.steps.is_none() {
            config.training.steps = 0; // the preset's steps would win
        }
        for given in &self.set {
            config = config.with_override(given)?;
        }
        Ok(config)
    }
}

/// The processor.
pub(crate) fn default_device() -> Vec<String> {
    vec!["cpu".to_owned()]
}

fn text<T: ToString>(value: &Option<T>) -> Option<String> {
    value.as_ref().map(T::to_string)
}

impl Default for TrainJob {
    fn default() -> Self {
        Self {
            config: None,
            out: None,
            resume: None,
            print_config: false,
            stop_after_step: None,
            device: default_device(),
            mpi: false,
            overrides: Overrides::default(),
        }
    }
}

/// A training with its configuration.
struct Run {
    config: Config,
    out: PathBuf,
    mode: RunMode,
}

impl TrainJob {
    /// A new run in the folder `out`.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self { out: Some(out.into()), ..Self::default() }
    }

    /// Continues the run in the folder `run`.
    pub fn resume(run: impl Into<PathBuf>) -> Self {
        Self { resume: Some(run.into()), ..Self::default() }
    }

    fn prepare(&self) -> anyhow::Result<Run> {
        if let Some(run) = &self.resume {
            anyhow::ensure!(
                self.overrides == Overrides::default() && self.config.is_none() && self.out.is_none(),
                "`resume` continues with the configuration of the run: leave out options that would change it"
            );
            return Ok(Run { config: config_of_run(run)?, out: run.clone(), mode: RunMode::Resume });
        }
        let out = match &self.out {
            Some(out) => out.clone(),
            None if self.print_config => PathBuf::new(),
            None => wrong_settings!(
                "`out` is missing: give the folder of the run, or one to continue as `resume`"
            ),
        };
        let config = self.overrides.configuration(self.config.as_deref())?;
        Ok(Run { config, out, mode: RunMode::New })
    }

    /// Trains together with the processes of `communicator`, each of which calls this with the same settings.
    ///
    /// # Errors
    /// Those of [`run`](Job::run). When this process has failed, or another one has
    /// ([`TrainError::OtherRank`](srflow_train::TrainError::OtherRank)), all of them have to end.
    pub fn train(&self, communicator: &dyn Communicator, watch: &Watch) -> anyhow::Result<TrainReport> {
        let Run { mut config, out, mode } = self.prepare()?;
        if self.print_config {
            config.check()?;
            return Ok(TrainReport::Configuration(Box::new(config)));
        }
        if mode == RunMode::New {
            find_weights(&mut config, watch)?;
        }
        let devices = self.device.iter().map(|name| device(name)).collect::<Result<Vec<_>, _>>()?;
        let stop = |done| self.stop_after_step.is_some_and(|last| done >= last) || watch.stops();
        let training = Training {
            config: &config,
            open_made: &open_made,
            devices: &devices,
            run: &out,
            mode,
            communicator,
        };
        let mut steps = Steps::new(watch);
        let outcome = training.until(&stop, &mut |event| steps.report(&event))?;
        if !outcome.stopped && communicator.rank() == 0 {
            let page = report(&config, &read_run_log(&out)?, &machine::describe()).html();
            write_file(&out.join("report.html"), page)?;
        }
        Ok(TrainReport::Trained(Trained::new(out, &outcome)))
    }
}

impl Job for TrainJob {
    const NAME: &'static str = "train";
    const WHEN_STOPPED: WhenStopped = WhenStopped::Saved;

    type Report = TrainReport;

    /// Trains in this process alone; see [`TrainJob::train`] for several.
    fn work(&self, watch: &Watch) -> anyhow::Result<TrainReport> {
        if self.mpi && !self.print_config {
            wrong_settings!("`mpi`: processes train together with the command `srflow train --mpi`");
        }
        self.train(&Alone, watch)
    }
}

/// Fetches published weights if a name and not a file is given.
pub(crate) fn find_weights(config: &mut Config, watch: &Watch) -> anyhow::Result<()> {
    let network = &mut config.network;
    if let Some(weights) = network.weights.to_str().filter(|weights| !weights.is_empty()) {
        network.weights = weights_file(Some(network.architecture), weights, watch)?;
        note_if_ambiguous(network.architecture, &network.weights)?;
    }
    Ok(())
}

/// What [`TrainJob`] has done.
#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
pub enum TrainReport {
    /// The configuration, with `print_config`.
    Configuration(Box<Config>),
    Trained(Trained),
}

/// A run that has ended, or was stopped.
#[derive(Debug, Clone, Serialize)]
pub struct Trained {
    /// Its folder.
    pub run: PathBuf,
    /// Steps of the run so far.
    pub steps: u64,
    /// Whether it was stopped before its last step.
    pub stopped: bool,
    /// Steps that were skipped, because their loss was not finite.
    pub skipped: u64,
    /// The step with the best validation; `None` without validation.
    pub best: Option<Best>,
    /// The weights of the best step, or of the last one without validation.
    pub weights: PathBuf,
    /// Wall-clock seconds of this process.
    pub seconds: f64,
    /// Share of step time spent waiting for data, `0..=1`.
    pub waiting_share: f64,
    pub peak_memory_bytes: Option<u64>,
    /// The part of several processes.
    #[serde(flatten)]
    pub together: Option<Together>,
}

/// How processes have trained together.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Together {
    /// Their number.
    pub ranks: usize,
    /// Share of the time that this one has waited for others, `0..=1`.
    pub waiting_for_ranks_share: f64,
    /// Share of the time spent summing gradients, `0..=1`.
    pub summing_share: f64,
}

impl Trained {
    fn new(run: PathBuf, outcome: &Outcome) -> Self {
        let Outcome { progress, stopped, seconds, waiting_share, ranks, .. } = outcome;
        let best = progress.best;
        let weights = if best.is_some() { "best.safetensors" } else { "last.safetensors" };
        let together = Together {
            ranks: *ranks,
            waiting_for_ranks_share: outcome.waiting_for_ranks_share,
            summing_share: outcome.summing_share,
        };
        Self {
            weights: run.join(weights),
            run,
            steps: progress.step,
            stopped: *stopped,
            skipped: progress.skipped,
            best,
            seconds: *seconds,
            waiting_share: *waiting_share,
            peak_memory_bytes: machine::peak_memory(),
            together: (*ranks > 1).then_some(together),
        }
    }
}

impl Report for TrainReport {
    fn stopped(&self) -> bool {
        matches!(self, Self::Trained(Trained { stopped: true, .. }))
    }
}

impl fmt::Display for TrainReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Configuration(config) => writeln!(f, "{}", config.to_toml().trim_end()),
            Self::Trained(trained) => trained.fmt(f),
        }
    }
}

impl fmt::Display for Trained {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { run, steps, stopped, skipped, best, weights, seconds, waiting_share, .. } = self;
        writeln!(f, "{steps} steps, {skipped} of them skipped, in {seconds:.1} s")?;
        writeln!(f, "Waiting for data  {:.1}% of the time", 100.0 * waiting_share)?;
        if let Some(Together { ranks, waiting_for_ranks_share, summing_share }) = self.together {
            writeln!(f, "Ranks             {ranks}")?;
            let [waiting, summing] = [waiting_for_ranks_share, summing_share].map(|share| 100.0 * share);
            writeln!(
                f,
                "  the first one   waited for others {waiting:.1}% and summed gradients {summing:.1}% of the time"
            )?;
        }
        if let Some(bytes) = self.peak_memory_bytes {
            writeln!(f, "Peak memory       {:.2} GB", bytes as f64 / 1e9)?;
        }
        let weights = weights.display();
        match best {
            Some(Best { step, epe }) => {
                write_line(
                    f,
                    format_args!("Best              EPE {epe:.4} px after step {step}: {weights}"),
                )?;
            }
            None => {
                write_line(f, format_args!("Weights           {weights}"))?;
                writeln!(f, "                  no best.safetensors: nothing was validated")?;
            }
        }
        if *stopped {
            write_line(
                f,
                format_args!("Stopped on request; srflow train --resume {} continues", run.display()),
            )?;
        }
        Ok(())
    }
}

/// Reports the progress of a run in steps. Its facts for programs are an `event` and the numbers that belong to it; what is worth
/// a line for people goes to the log.
pub(crate) struct Steps<'a> {
    watch: Watch<'a>,
    /// Steps done before this process.
    before: u64,
    total: u64,
    began: Instant,
}

impl<'a> Steps<'a> {
    pub fn new(watch: &Watch<'a>) -> Self {
        Self { watch: *watch, before: 0, total: 0, began: Instant::now() }
    }

    pub fn report(&mut self, event: &Event) {
        match event {
            Event::Started(start) => {
                (self.before, self.total, self.began) = (start.done, start.steps, Instant::now());
                log_start(start);
                let Start { done, steps_per_epoch, data, validation, parameters, .. } = start;
                let facts = json!({
                    "steps_per_epoch": steps_per_epoch, "data": data, "validation": validation, "parameters": parameters,
                });
                self.send("started", *done, String::new(), facts);
            }
            Event::Recorded(Record::Step(step)) => {
                let parts: Map<String, Value> =
                    step.parts.iter().map(|(name, value)| (name.clone(), json!(value))).collect();
                let mut facts = json!(step);
                facts["parts"] = parts.into();
                self.send("step", step.step, self.in_words(step), facts);
            }
            Event::Recorded(Record::Skipped(skipped)) => {
                let samples = skipped.samples.join(", ");
                log::info!("step {} skipped: its loss is not finite ({samples})", skipped.step);
                self.send("skipped", skipped.step, String::new(), json!(skipped));
            }
            Event::Recorded(Record::Validation(scores)) => {
                log::info!(
                    "step {}: EPE {:.4} px (zero flow {:.4}), px1 {:.4}, WAUC {:.2} on {}",
                    scores.step,
                    scores.whole.epe,
                    scores.zero_epe,
                    scores.whole.px1,
                    scores.whole.wauc,
                    scores.dataset
                );
                self.send("validation", scores.step, String::new(), json!(scores));
            }
            Event::Saved { path, step } => self.send("saved", *step, String::new(), json!({ "path": path })),
        }
    }

    fn send(&self, event: &str, done: u64, message: String, facts: Value) {
        let mut facts = match facts {
            Value::Object(facts) => facts,
            _ => Map::new(),
        };
        facts.insert("event".to_owned(), json!(event));
        (self.watch.on_progress)(&Progress {
            done,
            total: Some(self.total),
            unit: "steps".into(),
            message,
            facts,
        });
    }

    fn in_words(&self, step: &StepRecord) -> String {
        let rate = (step.step - self.before) as f64 / self.began.elapsed().as_secs_f64().max(1e-9);
        let parts: Vec<String> =
            step.parts.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
        format!("{rate:.2} steps/s, loss {:.4} ({}), EPE {:.3} px", step.loss, parts.join(", "), step.epe)
    }
}

/// What a run starts with.
fn log_start(start: &Start) {
    for line in &start.data {
        log::info!("{line}");
    }
    for line in &start.validation {
        log::info!("validation: {line}");
    }
    if start.validation.is_empty() {
        log::info!(
            "validation: none, because no training dataset has a val split with pairs; there will be no best.safetensors, \
             only last.safetensors (name a dataset with `validation`)"
        );
    }
    if start.frozen_batch_norm {
        log::info!(
            "batch norm: frozen at the statistics of the weights (network.batch_norm=live updates them)"
        );
    }
    if start.ranks > 1 {
        log::info!("{} ranks share each batch", start.ranks);
    }
    if let Some(before) = start.ranks_before {
        log::info!(
            "the number of ranks was {before} before: the weights will differ in rounding from those of an uninterrupted run"
        );
    }
    let epochs = start.steps as f64 / start.steps_per_epoch as f64;
    log::info!(
        "{} parameters, {} steps ({epochs:.1} epochs), from step {}",
        start.parameters,
        start.steps,
        start.done
    );
}
