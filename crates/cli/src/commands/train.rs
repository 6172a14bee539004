use std::cell::Cell;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::ensure;
use clap::Args;
use serde_json::{Value, json};
use srflow_files::{Preset, write_file};
use srflow_ops::device;
use srflow_train::config::{Config, PRESETS};
use srflow_train::ranks::{Alone, Communicator};
use srflow_train::training_log::{Record, StepRecord, read_log};
use srflow_train::{Event, Outcome, RunMode, Start, Training, config_of_run, report};

use crate::interrupt::{self, Continuable};
use crate::made::open_made;
use crate::networks::{note_if_ambiguous, weights_file};
use crate::output::exit_stopped;
use crate::progress::TrainingProgress;
use crate::{Context, machine, ranks};
use srflow::wrong_settings;

/// Train an optical flow network
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow train --config cpu-small --data srflow:DIR --out runs/first
  srflow train --config srflownet-fdr --data srflow:DIR --out runs/fdr --device cuda:0 --device cuda:1
  srflow train --config skflow --data folder:DIR --crop 384x512 --batch 4 --weights skflow.pth --out runs/mine
  srflow train --config skflow --set training.weight_decay=1e-5 --print-config
  srflow train --config cpu-small --data shapes: --data rendered:*2 --out runs/made
  srflow train --resume runs/first
  mpirun -n 4 srflow train --mpi --config skflow --data srflow:DIR --batch 8 --out runs/nodes

docs/guides/train.md is the guide: your own data, what the keys mean, what a run writes.")]
pub struct Train {
    /// Preset or TOML file to start from [default: the paper's retrained SKFlow]
    #[arg(long, value_name = "PRESET|FILE", help = config_help())]
    config: Option<PathBuf>,
    /// Folder of the run
    #[arg(long, value_name = "DIR", required_unless_present_any = ["resume", "print_config"])]
    out: Option<PathBuf>,
    /// Continue the run in this folder from its last checkpoint
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "config"])]
    resume: Option<PathBuf>,
    /// Print the configuration with every key as TOML, or with --json as JSON, and exit
    #[arg(long)]
    print_config: bool,
    /// Stop after this step with a checkpoint and exit code 75; --resume continues
    #[arg(long, value_name = "N")]
    stop_after_step: Option<u64>,
    /// Device to train on; several devices share each batch
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    device: Vec<String>,
    /// Share every batch with the other processes that `mpirun` or `srun` has started
    #[arg(long)]
    mpi: bool,
    #[command(flatten)]
    overrides: Overrides,
}

/// Keys of the configuration as options; `--set` reaches all keys.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Overriding the configuration")]
pub struct Overrides {
    /// Training dataset, KIND:DIR; several for a mix, KIND:DIR*TIMES; `shapes:` and `rendered:` make pairs while training
    #[arg(long, value_name = "KIND:DIR")]
    data: Vec<String>,
    /// Validation dataset [default: the val split of the training data]
    #[arg(long, value_name = "KIND:DIR")]
    validation: Vec<String>,
    /// Network
    #[arg(long, value_name = "NAME")]
    network: Option<String>,
    /// Initial weights: a file, or the name of published weights, such as things
    #[arg(long, value_name = "FILE|NAME")]
    weights: Option<String>,
    /// Number of steps; overrides the epochs
    #[arg(long, value_name = "N")]
    steps: Option<String>,
    /// Epochs
    #[arg(long, value_name = "N")]
    epochs: Option<String>,
    /// Batch size in pairs
    #[arg(long, value_name = "N")]
    batch: Option<String>,
    /// Crop size
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    crop: Option<String>,
    /// Refinement iterations of the network
    #[arg(long, value_name = "N")]
    iterations: Option<String>,
    /// Peak learning rate
    #[arg(long, value_name = "RATE")]
    learning_rate: Option<String>,
    /// Random seed
    #[arg(long, value_name = "N")]
    seed: Option<String>,
    /// Any key of the configuration, e.g. training.clip=0.5 or loss.fdr=0.05
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    set: Vec<String>,
}

fn config_help() -> String {
    format!("Preset ({}) or TOML file [default: skflow]", Preset::names(PRESETS))
}

impl Overrides {
    /// The configuration with the command line's overrides.
    pub fn apply(&self, mut config: Config) -> anyhow::Result<Config> {
        for (key, sources) in [("data.train", &self.data), ("validation.data", &self.validation)] {
            if !sources.is_empty() {
                let list = serde_json::to_string(sources)?; // a list of strings is the same in TOML
                config = config.with_override(&format!("{key}={list}"))?;
            }
        }
        let single = [
            ("network.architecture", &self.network),
            ("network.weights", &self.weights),
            ("training.steps", &self.steps),
            ("training.epochs", &self.epochs),
            ("training.batch", &self.batch),
            ("data.crop", &self.crop),
            ("training.iterations", &self.iterations),
            ("training.learning_rate", &self.learning_rate),
            ("training.seed", &self.seed),
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

    fn is_empty(&self) -> bool {
        let Self {
            data,
            validation,
            network,
            weights,
            steps,
            epochs,
            batch,
            crop,
            iterations,
            learning_rate,
            seed,
            set,
        } = self;
        let lists = [data, validation, set];
        let single = [network, weights, steps, epochs, batch, crop, iterations, learning_rate, seed];
        lists.iter().all(|list| list.is_empty()) && single.iter().all(|value| value.is_none())
    }
}

/// The run that the arguments describe.
struct Job {
    config: Config,
    out: PathBuf,
    mode: RunMode,
    devices: Vec<String>,
    stop_after: Option<u64>,
}

impl Train {
    fn job(self) -> anyhow::Result<Job> {
        if self.resume.is_some() {
            ensure!(
                self.overrides.is_empty(),
                "--resume continues with the configuration of the run: leave out options that would change it"
            );
        }
        let (config, out, mode) = match (self.resume, self.out) {
            (Some(run), _) => (config_of_run(&run)?, run, RunMode::Resume),
            (None, out) => {
                let config = match &self.config {
                    Some(name) => Config::read(name)?,
                    None => Config::default(),
                };
                (self.overrides.apply(config)?, out.unwrap_or_default(), RunMode::New)
            }
        };
        Ok(Job { config, out, mode, devices: self.device, stop_after: self.stop_after_step })
    }
}

impl Job {
    /// Trains, and writes the report of a run that is then complete.
    fn run(
        &mut self,
        communicator: &dyn Communicator,
        stop: &dyn Fn() -> bool,
        on_event: &mut dyn FnMut(Event<'_>),
    ) -> anyhow::Result<Outcome> {
        let Self { config, out, mode, devices, stop_after } = self;
        if *mode == RunMode::New {
            find_weights(config)?;
        }
        let devices = devices.iter().map(|name| device(name)).collect::<Result<Vec<_>, _>>()?;
        let stop = |done| stop_after.is_some_and(|last| done >= last) || stop();
        let training = Training {
            config,
            open_made: &open_made,
            devices: &devices,
            run: out,
            mode: *mode,
            communicator,
        };
        let outcome = training.until(&stop, on_event)?;
        if !outcome.stopped && communicator.rank() == 0 {
            let page = report(config, &read_log(out)?, &machine::describe()).html();
            write_file(&out.join("report.html"), page)?;
        }
        Ok(outcome)
    }
}

pub fn run(args: Train, context: &Context) -> anyhow::Result<()> {
    let (print_config, mpi) = (args.print_config, args.mpi);
    let mut job = args.job()?;
    if print_config {
        job.config.check()?;
        if context.json {
            return crate::output::print_json(&job.config);
        }
        return say!("{}", job.config.to_toml().trim_end());
    }
    let communicator = ranks::start(mpi)?;
    let mut progress = Progress::new();
    let continuable = Continuable::saved();
    let result = job.run(&*communicator, &interrupt::requested, &mut |event| progress.show(&event));
    drop(continuable);
    progress.finish();
    let result = result.and_then(|outcome| {
        if communicator.rank() == 0 {
            print(&job.out, &outcome, context)?;
        }
        Ok(outcome.stopped)
    });
    if communicator.ranks() > 1
        && let Err(error) = &result
    {
        ranks::exit_failed(communicator, error, context);
    }
    drop(communicator);
    if result? { exit_stopped() } else { Ok(()) }
}

/// Fetches published weights if a name and not a file is given.
pub fn find_weights(config: &mut Config) -> anyhow::Result<()> {
    let network = &mut config.network;
    if let Some(weights) = network.weights.to_str().filter(|weights| !weights.is_empty()) {
        network.weights = weights_file(Some(network.architecture), weights, &crate::run::WATCH)?;
        note_if_ambiguous(network.architecture, &network.weights)?;
    }
    Ok(())
}

fn weights_of(out: &Path) -> [PathBuf; 2] {
    ["best.safetensors", "last.safetensors"].map(|name| out.join(name))
}

fn summary(out: &Path, outcome: &Outcome) -> Value {
    let Outcome { progress, stopped, seconds, waiting_share, ranks, .. } = outcome;
    let [best, last] = weights_of(out);
    let mut summary = json!({
        "run": out,
        "steps": progress.step,
        "stopped": stopped,
        "skipped": progress.skipped,
        "best": progress.best,
        "weights": if progress.best.is_some() { best } else { last },
        "seconds": seconds,
        "waiting_share": waiting_share,
        "peak_memory_bytes": machine::peak_memory(),
    });
    if *ranks > 1 {
        summary["ranks"] = json!(ranks);
        summary["waiting_for_ranks_share"] = json!(outcome.waiting_for_ranks_share);
        summary["summing_share"] = json!(outcome.summing_share);
    }
    summary
}

fn print(out: &Path, outcome: &Outcome, context: &Context) -> anyhow::Result<()> {
    if context.json {
        return crate::output::print_json(&summary(out, outcome));
    }
    let Outcome { progress, stopped, seconds, waiting_share, ranks, .. } = outcome;
    let peak = machine::peak_memory();
    let [best, last] = weights_of(out);
    say!("{} steps, {} of them skipped, in {seconds:.1} s", progress.step, progress.skipped)?;
    say!("Waiting for data  {:.1}% of the time", 100.0 * waiting_share)?;
    if *ranks > 1 {
        say!("Ranks             {ranks}")?;
        let [waiting, summing] =
            [outcome.waiting_for_ranks_share, outcome.summing_share].map(|share| 100.0 * share);
        say!(
            "  the first one   waited for others {waiting:.1}% and summed gradients {summing:.1}% of the time"
        )?;
    }
    if let Some(bytes) = peak {
        say!("Peak memory       {:.2} GB", bytes as f64 / 1e9)?;
    }
    match progress.best {
        Some(best_step) => {
            say!(
                "Best              EPE {:.4} px after step {}: {}",
                best_step.epe,
                best_step.step,
                best.display()
            )?;
        }
        None => {
            say!("Weights           {}", last.display())?;
            say!("                  no best.safetensors: nothing was validated")?;
        }
    }
    if *stopped {
        say!("Stopped on request; srflow train --resume {} continues", out.display())?;
    }
    Ok(())
}

/// Progress of a run.
pub struct Progress(TrainingProgress);

impl Progress {
    pub fn new() -> Self {
        Self(TrainingProgress::new("step"))
    }

    pub fn show(&mut self, event: &Event) {
        match event {
            Event::Started(start) => self.start(start),
            Event::Recorded(record) => self.record(record),
            Event::Saved { .. } => {}
        }
    }

    fn start(&mut self, start: &Start) {
        self.0.start(start.done, start.steps);
        for line in &start.data {
            self.line(line);
        }
        for line in &start.validation {
            self.line(&format!("validation: {line}"));
        }
        if start.validation.is_empty() {
            self.line(
                "validation: none, because no training dataset has a val split with pairs; there will be no best.safetensors, \
                 only last.safetensors (name a dataset with --validation)",
            );
        }
        if start.frozen_batch_norm {
            self.line(
                "batch norm: frozen at the statistics of the weights (--set network.batch_norm=live updates them)",
            );
        }
        if start.ranks > 1 {
            self.line(&format!("{} ranks share each batch", start.ranks));
        }
        if let Some(before) = start.ranks_before {
            self.line(&format!(
                "the number of ranks was {before} before: the weights will differ in rounding from those of an uninterrupted run"
            ));
        }
        let epochs = start.steps as f64 / start.steps_per_epoch as f64;
        self.line(&format!(
            "{} parameters, {} steps ({epochs:.1} epochs), from step {}",
            start.parameters, start.steps, start.done
        ));
    }

    fn record(&mut self, record: &Record) {
        match record {
            Record::Step(step) => self.0.advance(step.step, |rate| in_words(step, rate)),
            Record::Skipped(skipped) => {
                self.0.skip(skipped.step);
                self.line(&format!(
                    "step {} skipped: its loss is not finite ({})",
                    skipped.step,
                    skipped.samples.join(", ")
                ));
            }
            Record::Validation(scores) => self.line(&format!(
                "step {}: EPE {:.4} px (zero flow {:.4}), px1 {:.4}, WAUC {:.2} on {}",
                scores.step,
                scores.whole.epe,
                scores.zero_epe,
                scores.whole.px1,
                scores.whole.wauc,
                scores.dataset
            )),
        }
    }

    pub fn finish(&self) {
        self.0.finish();
    }

    pub fn line(&self, text: &str) {
        self.0.line(text);
    }
}

fn in_words(step: &StepRecord, rate: f64) -> String {
    let parts: Vec<String> = step.parts.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
    format!("{rate:.2} steps/s, loss {:.4} ({}), EPE {:.3} px", step.loss, parts.join(", "), step.epe)
}
