//! `srflow avatar train`.

mod page;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use clap::Args;
use serde_json::json;
use srflow_avatar::capture::{Capture, CaptureSplit, HEAD_NAME, HeadRecord};
use srflow_avatar::train::{
    IterationsRecord, LogRecord, PRESETS, RunEvent, RunMode, RunOutcome, RunRecord, RunRequest, StepReport,
    TrainConfig, Trainer, read_run, read_run_log, run as train,
};
use srflow_avatar::{HeadModel, HeadSource};
use srflow_files::{Preset, SettingsError, read_settings, settings_text, with_setting, write_file};

use super::scores::{split_table, split_words};
use crate::commands::render::head_help;
use crate::interrupt::{self, Continuable};
use crate::output::{ensure_folder, exit_stopped, print_json, print_tables};
use crate::progress::TrainingProgress;
use crate::usage::wrong_usage;
use crate::{Context, machine};

/// Train an avatar of 3D Gaussians on a capture
///
/// Gaussians bound to the triangles of the head model are learned from the pictures, as in GaussianAvatars, and its poses are
/// corrected. Pictures of a held-out camera and of held-out timesteps are scored. Writes the avatar in GaussianAvatars' files and a
/// report. docs/guides/fit-and-train-avatars.md describes the files and the settings.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow avatar train capture --config cpu --out runs/first
  srflow avatar train fitted --model flame:flame2023.pkl --out runs/person
  srflow avatar train capture --config cpu --strategy absgs --set rates.sh_0=0.005 --out runs/absgs
  srflow avatar train --config cpu --print-config
  srflow avatar train --resume runs/first
  srflow render --head avatar:runs/first --scenes 4 --frames 200 --out dataset")]
pub struct Train {
    /// Folder of the capture, as VHAP exports it
    #[arg(value_name = "DATA", required_unless_present_any = ["resume", "print_config"])]
    data: Option<PathBuf>,
    /// Folder of the run, new or empty
    #[arg(short, long, value_name = "DIR", required_unless_present_any = ["resume", "print_config"])]
    out: Option<PathBuf>,
    /// Continue the run in this folder from its last checkpoint; DATA and --model tell where its capture and head model have moved
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "config", "Overrides"])]
    resume: Option<PathBuf>,
    /// Head model
    #[arg(long, value_name = "HEAD", help = model_help())]
    model: Option<HeadSource>,
    /// Seed of the person, of a built-in head [default: that in head.json of the capture, else 1]
    #[arg(long, value_name = "N")]
    subject: Option<u64>,
    /// Preset or TOML file to start from
    #[arg(long, visible_alias = "preset", value_name = "PRESET|FILE", help = config_help())]
    config: Option<PathBuf>,
    /// Print the configuration with every key as TOML, or with --json as JSON, and exit
    #[arg(long)]
    print_config: bool,
    /// Least time between two checkpoints
    #[arg(long, value_name = "MINUTES", default_value_t = 2.0)]
    checkpoint_every: f64,
    /// Stop after this iteration, or up to 100 later, with a checkpoint and exit code 75; --resume continues
    #[arg(long, value_name = "N")]
    stop_after: Option<u64>,
    #[command(flatten)]
    overrides: Overrides,
}

/// Keys of the configuration as options; `--set` reaches all keys.
#[derive(Args)]
#[command(next_help_heading = "Overriding the configuration")]
#[group(multiple = true)]
struct Overrides {
    /// Number of iterations, one picture each
    #[arg(long, value_name = "N")]
    iterations: Option<String>,
    /// Random seed
    #[arg(long, value_name = "N")]
    seed: Option<String>,
    /// How Gaussians are added and removed: default (3D Gaussian Splatting), absgs or mcmc
    #[arg(long, value_name = "NAME")]
    strategy: Option<String>,
    /// Render Gaussians smaller than a pixel antialiased; see docs/guides/rasterize.md
    #[arg(long)]
    antialiased: bool,
    /// Keep the defects of GaussianAvatars' code, listed in docs/explanation/avatars.md
    #[arg(long)]
    faithful: bool,
    /// Any key of the configuration, e.g. ssim_weight=0.1 or density.until=15000
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

fn model_help() -> String {
    format!("{} [default: the one that head.json of the capture names]", head_help())
}

fn config_help() -> String {
    format!("Preset ({}) or TOML file to start from [default: gaussian-avatars]", Preset::names(PRESETS))
}

impl Overrides {
    /// The configuration with the command line's overrides.
    fn apply(&self, mut config: TrainConfig) -> Result<TrainConfig, SettingsError> {
        let switch = |given: bool| given.then(|| "true".to_owned());
        let single = [
            ("iterations", &self.iterations),
            ("seed", &self.seed),
            ("density.strategy", &self.strategy),
            ("antialiased", &switch(self.antialiased)),
            ("faithful", &switch(self.faithful)),
        ];
        let single = single.iter().filter_map(|(key, value)| Some(format!("{key}={}", value.as_ref()?)));
        for given in single.chain(self.set.iter().cloned()) {
            config = with_setting(&config, &given)?;
        }
        Ok(config)
    }
}

pub fn run(args: Train, context: &Context) -> anyhow::Result<()> {
    let minutes = args.checkpoint_every;
    let Ok(checkpoint_interval) = Duration::try_from_secs_f64(60.0 * minutes) else {
        wrong_usage!("--checkpoint-every {minutes}: expected a number of minutes from 0");
    };
    if args.print_config {
        let config = config(&args)?;
        config.check()?;
        if context.json {
            return print_json(&config);
        }
        return say!("{}", settings_text(&config).trim_end());
    }
    let (dir, mode, known, config) = match (&args.resume, &args.out) {
        (Some(dir), _) => {
            let (record, config) = read_run(dir)?;
            (dir.clone(), RunMode::Resume, Some(record), config)
        }
        (None, out) => {
            let out = out.clone().unwrap_or_default();
            ensure_folder(&out)?;
            (out, RunMode::New, None, config(&args)?)
        }
    };
    config.check()?;
    let data = args.data.clone().or_else(|| known.as_ref().map(|known| known.data.clone()));
    let capture = Capture::read(&data.unwrap_or_default())?;
    let named = match known {
        Some(record) => Some(record.head),
        None => HeadRecord::read(capture.dir())?,
    };
    let (model, head) = model(&args, capture.dir(), named)?;
    let data = capture.dir().canonicalize();
    let data = data.with_context(|| format!("{}: finding the folder", capture.dir().display()))?;
    let request = RunRequest {
        dir: &dir,
        mode,
        record: RunRecord { data, head },
        capture,
        model,
        config,
        checkpoint_interval,
        stop: &|done| args.stop_after.is_some_and(|last| done >= last) || interrupt::requested(),
    };
    let mut progress = Progress::new();
    let continuable = Continuable::saved();
    let result = train(request, &mut |event| progress.show(&event));
    drop(continuable);
    progress.bar.finish();
    let outcome = result?;
    if outcome.scores.is_some() {
        let page = page::page(&outcome, &read_run_log(&dir)?)?;
        write_file(&dir.join(REPORT_NAME), page.html())?;
    }
    print(&dir, &outcome, context)?;
    if outcome.scores.is_none() { exit_stopped() } else { Ok(()) }
}

const REPORT_NAME: &str = "report.html";

fn config(args: &Train) -> Result<TrainConfig, SettingsError> {
    let config = match &args.config {
        Some(name) => read_settings(name, PRESETS)?,
        None => TrainConfig::default(),
    };
    args.overrides.apply(config)
}

/// The head model, given or `named` by the capture or an earlier part of the run.
fn model(args: &Train, capture: &Path, named: Option<HeadRecord>) -> anyhow::Result<(HeadModel, HeadRecord)> {
    let source = match (&args.model, &named) {
        (Some(model), _) => model.clone(),
        (None, Some(record)) => record.head.parse().map_err(|reason| {
            anyhow!("{}: {reason}; give the head model with --model", capture.join(HEAD_NAME).display())
        })?,
        (None, None) => wrong_usage!(
            "{}: no {HEAD_NAME} names the head model of this capture; give it with --model, e.g. --model flame:flame2023.pkl",
            capture.display()
        ),
    };
    let subject = args.subject.or(named.as_ref().map(|record| record.subject)).unwrap_or(1);
    let model = source.model(subject).with_context(|| format!("reading the head model {source}"))?;
    if let Some(record) = named {
        record.check(capture, &model)?;
        if !record.may_be(&model) {
            wrong_usage!(
                "{source} of seed {subject} is not the head of the capture, {} of seed {}; leave out --model and --subject",
                record.head,
                record.subject
            );
        }
    }
    let record = source.record(subject, &model)?;
    Ok((model, record))
}

fn print(dir: &Path, outcome: &RunOutcome, context: &Context) -> anyhow::Result<()> {
    let RunOutcome { trainer, scores, avatar, seconds, .. } = outcome;
    let (iteration, gaussians) = (trainer.iteration(), trainer.avatar().bound().len());
    let peak = machine::peak_memory();
    let report = dir.join(REPORT_NAME);
    if context.json {
        let finished = scores.is_some();
        return print_json(&json!({
            "run": dir,
            "iteration": iteration,
            "stopped": !finished,
            "gaussians": gaussians,
            "scores": scores.iter().flat_map(|scores| &scores.splits).map(|split| &split.scores).collect::<Vec<_>>(),
            "avatar": finished.then_some(avatar),
            "report": finished.then_some(&report),
            "seconds": seconds,
            "peak_memory_bytes": peak,
        }));
    }
    say!("{iteration} iterations, {gaussians} Gaussians, in {seconds:.1} s")?;
    if let Some(bytes) = peak {
        say!("Peak memory  {:.2} GB", bytes as f64 / 1e9)?;
    }
    let Some(scores) = scores else {
        return say!("Stopped on request; srflow avatar train --resume {} continues", dir.display());
    };
    say!("Avatar       {}", avatar.display())?;
    say!("Report       {}\n", report.display())?;
    if scores.splits.is_empty() {
        return say!("No scores: the capture has neither a held-out camera nor held-out timesteps.");
    }
    print_tables(&[split_table(scores.splits.iter().map(|split| &split.scores))])
}

/// Progress of a run.
struct Progress {
    bar: TrainingProgress,
    /// The last line of the log.
    last: Option<IterationsRecord>,
}

impl Progress {
    fn new() -> Self {
        Self { bar: TrainingProgress::new("iteration"), last: None }
    }

    fn show(&mut self, event: &RunEvent) {
        match event {
            RunEvent::Started { trainer, iterations } => self.start(trainer, *iterations),
            RunEvent::Stepped(report) => self.step(report),
            RunEvent::Recorded(LogRecord::Iterations(record)) => self.last = Some(record.clone()),
            RunEvent::Recorded(LogRecord::Scores(scores)) => {
                let ratio =
                    |ratio: Option<f64>| ratio.map_or("infinite".to_owned(), |db| format!("{db:.2} dB"));
                self.bar.line(&format!(
                    "iteration {}: PSNR {} (mean of channels {}), SSIM {:.4} on {} pictures ({})",
                    scores.iteration,
                    ratio(scores.psnr),
                    ratio(scores.psnr_channels),
                    scores.ssim,
                    scores.pictures,
                    scores.split
                ));
            }
            RunEvent::Saved { .. } => {}
            RunEvent::Scored { split, done, pictures } => {
                self.bar.message(format!("scoring: {} {done}/{pictures}", split_words(*split)));
            }
        }
    }

    fn start(&mut self, trainer: &Trainer, iterations: u64) {
        self.bar.start(trainer.iteration(), iterations);
        let capture = trainer.capture();
        let [training, camera, timesteps] = CaptureSplit::ALL.map(|split| capture.of(split).count());
        self.bar.line(&format!(
            "{training} pictures for training, {camera} of a held-out camera, {timesteps} of held-out timesteps"
        ));
        self.bar.line(&format!(
            "{} Gaussians on the head model {}, {} iterations, from iteration {}",
            trainer.avatar().bound().len(),
            trainer.avatar().model().name,
            iterations,
            trainer.iteration()
        ));
    }

    fn step(&mut self, report: &StepReport) {
        let last = self.last.as_ref();
        let last = last.map(|last| format!(", loss {:.4}, {} Gaussians", last.loss, last.gaussians));
        let last = last.unwrap_or_default();
        self.bar.advance(report.iteration, |rate| format!("{rate:.1} iterations/s{last}"));
    }
}
