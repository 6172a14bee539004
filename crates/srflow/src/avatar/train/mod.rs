//! Training of avatars on captures.

mod page;

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use srflow_avatar::HeadSource;
use srflow_avatar::capture::{Capture, CaptureSplit, HEAD_NAME, HeadRecord};
use srflow_avatar::train::{
    IterationsRecord, LogRecord, PRESETS, RunEvent, RunOutcome, RunRecord, RunRequest, ScoresRecord,
    SplitScore, StepReport, TrainConfig, Trainer, read_run, run,
};
use srflow_core::SettingError;
use srflow_files::{
    Preset, RunMode, SettingsError, read_run_log, read_settings, settings_text, with_setting, write_file,
};
use srflow_head::HeadModel;

use super::scores::{split_table, split_words};
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::{ensure_folder, write_line, write_tables};
use crate::render::head_help;
use crate::watch::Progress;
use crate::{Job, Report, Watch, WhenStopped, machine};

/// Train an avatar of 3D Gaussians on a capture
///
/// Gaussians bound to the triangles of the head model are learned from the pictures, as in GaussianAvatars, and its poses are
/// corrected. Pictures of a held-out camera and of held-out timesteps are scored. Writes the avatar in GaussianAvatars' files and a
/// report. docs/guides/fit-and-train-avatars.md describes the settings.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(after_help = "Examples:
  srflow avatar train capture --config cpu --out runs/first
  srflow avatar train fitted --model flame:flame2023.pkl --out runs/person
  srflow avatar train capture --config cpu --strategy absgs --set rates.sh_0=0.005 --out runs/absgs
  srflow avatar train --config cpu --print-config
  srflow avatar train --resume runs/first
  srflow render --head avatar:runs/first --scenes 4 --frames 200 --out dataset")]
pub struct TrainJob {
    /// Folder of the capture, as VHAP exports it
    #[arg(value_name = "DATA", required_unless_present_any = ["resume", "print_config"])]
    pub data: Option<PathBuf>,
    /// Folder of the run, new or empty
    #[arg(short, long, value_name = "DIR", required_unless_present_any = ["resume", "print_config"])]
    pub out: Option<PathBuf>,
    /// Continue the run in this folder from its last checkpoint; pass DATA and --model if the capture or head
    /// model has moved
    #[arg(long, value_name = "DIR", conflicts_with_all = ["out", "config", "Overrides"])]
    pub resume: Option<PathBuf>,
    /// Head model
    #[arg(long, value_name = "HEAD", help = model_help())]
    pub model: Option<HeadSource>,
    /// Seed of a built-in head [default: that in head.json of the capture, else 1]
    #[arg(long, value_name = "N")]
    pub subject: Option<u64>,
    /// Preset or TOML file to start from
    #[arg(long, visible_alias = "preset", value_name = "PRESET|FILE", help = config_help())]
    pub config: Option<PathBuf>,
    /// Print the configuration with every key instead of training, as TOML or JSON
    #[arg(long)]
    pub print_config: bool,
    /// Minimum time between two checkpoints
    #[arg(long, value_name = "MINUTES", default_value_t = Self::default().checkpoint_every)]
    pub checkpoint_every: f64,
    /// Write a checkpoint and stop after this iteration or up to 100 later; --resume continues
    #[arg(long, value_name = "N")]
    pub stop_after: Option<u64>,
    #[command(flatten)]
    #[serde(flatten)]
    pub overrides: Overrides,
}

impl Default for TrainJob {
    fn default() -> Self {
        Self {
            data: None,
            out: None,
            resume: None,
            model: None,
            subject: None,
            config: None,
            print_config: false,
            checkpoint_every: 2.0,
            stop_after: None,
            overrides: Overrides::default(),
        }
    }
}

/// Keys of the configuration as settings; `set` reaches all keys.
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
#[command(next_help_heading = "Overriding the configuration")]
#[group(multiple = true)]
pub struct Overrides {
    /// Number of iterations, one picture each; all that the configuration schedules moves along
    #[arg(long, value_name = "N")]
    pub iterations: Option<u64>,
    /// Random seed
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Strategy that adds and removes Gaussians: default (3D Gaussian Splatting), absgs or mcmc
    #[arg(long, value_name = "NAME")]
    pub strategy: Option<String>,
    /// Render Gaussians smaller than a pixel antialiased; see docs/guides/rasterize.md
    #[arg(long)]
    pub antialiased: bool,
    /// Keep the defects of GaussianAvatars' code, listed in docs/explanation/avatars.md
    #[arg(long)]
    pub faithful: bool,
    /// Any key of the configuration, e.g. ssim_weight=0.1 or density.until=15000
    #[arg(long, value_name = "KEY=VALUE")]
    #[serde(deserialize_with = "crate::assignments::deserialize")]
    pub set: Vec<String>,
}

fn model_help() -> String {
    format!("{} [default: the one that head.json of the capture names]", head_help())
}

fn config_help() -> String {
    format!("Preset ({}) or TOML file to start from [default: gaussian-avatars]", Preset::names(PRESETS))
}

impl Overrides {
    /// The configuration with these settings.
    fn apply(&self, mut config: TrainConfig) -> Result<TrainConfig, SettingsError> {
        if let Some(iterations) = self.iterations {
            config = config.over(iterations);
        }
        let text = |number: Option<u64>| number.map(|number| number.to_string());
        let switch = |given: bool| given.then(|| "true".to_owned());
        let single = [
            ("seed", text(self.seed)),
            ("density.strategy", self.strategy.clone()),
            ("antialiased", switch(self.antialiased)),
            ("faithful", switch(self.faithful)),
        ];
        let single = single.into_iter().filter_map(|(key, value)| Some(format!("{key}={}", value?)));
        for given in single.chain(self.set.iter().cloned()) {
            config = with_setting(&config, &given)?;
        }
        Ok(config)
    }
}

const REPORT_NAME: &str = "report.html";

impl Job for TrainJob {
    const NAME: &'static str = "avatar train";
    const WHEN_STOPPED: WhenStopped = WhenStopped::Saved;

    type Report = TrainReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<TrainReport> {
        let minutes = self.checkpoint_every;
        let Ok(checkpoint_interval) = Duration::try_from_secs_f64(60.0 * minutes) else {
            let (field, expected) = ("checkpoint_every", "a number of minutes from 0".to_owned());
            return Err(SettingError { field, found: minutes.to_string(), expected }.into());
        };
        if self.print_config {
            let config = self.configuration()?;
            config.check()?;
            return Ok(TrainReport::Configuration(config));
        }
        let (dir, mode, known, config) = match (&self.resume, &self.out) {
            (Some(_), _)
                if self.out.is_some() || self.config.is_some() || self.overrides != Overrides::default() =>
            {
                wrong_settings!(
                    "`resume` continues with the configuration of the run: leave out `out`, `config` and other settings that would \
                     change it"
                )
            }
            (Some(dir), _) => {
                let (record, config) = read_run(dir)?;
                (dir, RunMode::Resume, Some(record), config)
            }
            (None, Some(out)) => {
                ensure_folder(out)?;
                (out, RunMode::New, None, self.configuration()?)
            }
            (None, None) => wrong_settings!("give `out`, the folder of the run, or `resume`"),
        };
        config.check()?;
        let Some(data) = self.data.clone().or_else(|| known.as_ref().map(|known| known.data.clone())) else {
            wrong_settings!("give `data`, the folder of the capture")
        };
        let capture = Capture::read(&data)?;
        let named = match known {
            Some(record) => Some(record.head),
            None => HeadRecord::read(capture.dir())?,
        };
        let (model, head) = self.head_model(capture.dir(), named)?;
        let data = capture.dir().canonicalize();
        let data = data.with_context(|| format!("{}: finding the folder", capture.dir().display()))?;
        let request = RunRequest {
            dir,
            mode,
            record: RunRecord { data, head },
            capture,
            model,
            config,
            checkpoint_interval,
            stop: &|done| self.stop_after.is_some_and(|last| done >= last) || watch.stops(),
        };
        let mut iterations = Iterations::new(watch);
        let outcome = run(request, &mut |event| iterations.report(&event))?;
        if outcome.scores.is_some() {
            let page = page::page(&outcome, &read_run_log(dir)?)?;
            write_file(&dir.join(REPORT_NAME), page.html())?;
        }
        Ok(TrainReport::Run(TrainedAvatar::new(dir, &outcome)))
    }
}

impl TrainJob {
    /// The configuration of a new run.
    fn configuration(&self) -> Result<TrainConfig, SettingsError> {
        let config = match &self.config {
            Some(name) => read_settings(name, PRESETS)?,
            None => TrainConfig::default(),
        };
        self.overrides.apply(config)
    }

    /// The head model, given or `named` by the capture or an earlier part of the run.
    fn head_model(
        &self,
        capture: &Path,
        named: Option<HeadRecord>,
    ) -> anyhow::Result<(HeadModel, HeadRecord)> {
        let source = match (&self.model, &named) {
            (Some(model), Some(record)) => model.with_look(record.look),
            (Some(model), None) => model.clone(),
            (None, Some(record)) => record.source().map_err(|reason| {
                anyhow!("{}: {reason}; give the head as `model`", capture.join(HEAD_NAME).display())
            })?,
            (None, None) => wrong_settings!(
                "{}: no {HEAD_NAME} names the head model of this capture; give it as `model`, e.g. flame:flame2023.pkl",
                capture.display()
            ),
        };
        let subject = self.subject.or(named.as_ref().map(|record| record.subject)).unwrap_or(1);
        let model = source.model(subject).with_context(|| format!("reading the head model {source}"))?;
        if let Some(record) = named {
            record.check(capture, &model)?;
            if !record.may_be(&model) {
                wrong_settings!(
                    "{source} of seed {subject} is not the head of the capture, {} of seed {}; leave out `model` and `subject`",
                    record.head,
                    record.subject
                );
            }
        }
        let record = source.record(subject, &model)?;
        Ok((model, record))
    }
}

/// What [`TrainJob`] did.
#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
pub enum TrainReport {
    /// With `print_config`.
    Configuration(TrainConfig),
    Run(TrainedAvatar),
}

/// A run, complete or stopped.
#[derive(Debug, Clone, Serialize)]
pub struct TrainedAvatar {
    /// Folder of the avatar, once the run is complete.
    pub avatar: Option<PathBuf>,
    pub gaussians: usize,
    /// Finished iterations.
    pub iteration: u64,
    pub peak_memory_bytes: Option<u64>,
    /// The report as a page, once the run is complete.
    pub report: Option<PathBuf>,
    pub run: PathBuf,
    /// Of each split with held-out pictures, once the run is complete.
    pub scores: Vec<SplitScore>,
    /// Wall-clock seconds of this process.
    pub seconds: f64,
    pub stopped: bool,
}

impl TrainedAvatar {
    fn new(dir: &Path, outcome: &RunOutcome) -> Self {
        let RunOutcome { trainer, scores, avatar, seconds, .. } = outcome;
        let finished = scores.is_some();
        Self {
            avatar: finished.then(|| avatar.clone()),
            gaussians: trainer.avatar().bound().len(),
            iteration: trainer.iteration(),
            peak_memory_bytes: machine::peak_memory(),
            report: finished.then(|| dir.join(REPORT_NAME)),
            run: dir.to_owned(),
            scores: scores
                .iter()
                .flat_map(|scores| &scores.splits)
                .map(|split| split.scores.clone())
                .collect(),
            seconds: *seconds,
            stopped: !finished,
        }
    }
}

impl Report for TrainReport {
    fn stopped(&self) -> bool {
        matches!(self, Self::Run(run) if run.stopped)
    }
}

impl fmt::Display for TrainReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Configuration(config) => writeln!(f, "{}", settings_text(config).trim_end()),
            Self::Run(run) => run.fmt(f),
        }
    }
}

impl fmt::Display for TrainedAvatar {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { iteration, gaussians, seconds, .. } = self;
        writeln!(f, "{iteration} iterations, {gaussians} Gaussians, in {seconds:.1} s")?;
        if let Some(bytes) = self.peak_memory_bytes {
            writeln!(f, "Peak memory  {:.2} GB", bytes as f64 / 1e9)?;
        }
        let (Some(avatar), Some(report)) = (&self.avatar, &self.report) else {
            let run = self.run.display();
            return write_line(
                f,
                format_args!("Stopped on request; srflow avatar train --resume {run} continues"),
            );
        };
        write_line(f, format_args!("Avatar       {}", avatar.display()))?;
        write_line(f, format_args!("Report       {}", report.display()))?;
        writeln!(f)?;
        if self.scores.is_empty() {
            return writeln!(
                f,
                "No scores: the capture has neither a held-out camera nor held-out timesteps."
            );
        }
        write_tables(f, &[split_table(&self.scores)])
    }
}

/// Reports the progress of a run. Each report has the fact `event`: `started`, `step`, `scores`, `saved` or `scored`.
struct Iterations<'a> {
    watch: Watch<'a>,
    /// Finished before this process.
    before: u64,
    done: u64,
    total: u64,
    began: Instant,
    /// The last line of the log.
    last: Option<IterationsRecord>,
}

impl<'a> Iterations<'a> {
    fn new(watch: &Watch<'a>) -> Self {
        Self { watch: *watch, before: 0, done: 0, total: 0, began: Instant::now(), last: None }
    }

    fn report(&mut self, event: &RunEvent) {
        match event {
            RunEvent::Started { trainer, iterations } => self.start(trainer, *iterations),
            RunEvent::Stepped(report) => self.step(report),
            RunEvent::Recorded(LogRecord::Iterations(record)) => self.last = Some(record.clone()),
            RunEvent::Recorded(LogRecord::Scores(scores)) => {
                log_scores(scores);
                self.send("scores", String::new(), json!(scores));
            }
            RunEvent::Saved { iteration } => {
                self.send("saved", String::new(), json!({ "iteration": iteration }));
            }
            RunEvent::Scored { split, done, pictures } => {
                let message = format!("scoring: {} {done}/{pictures}", split_words(*split));
                self.send("scored", message, json!({ "split": split, "scored": done, "pictures": pictures }));
            }
        }
    }

    fn start(&mut self, trainer: &Trainer, iterations: u64) {
        (self.before, self.done) = (trainer.iteration(), trainer.iteration());
        (self.total, self.began) = (iterations, Instant::now());
        let capture = trainer.capture();
        let [training, camera, timesteps] = CaptureSplit::ALL.map(|split| capture.of(split).count());
        log::info!(
            "{training} pictures for training, {camera} of a held-out camera, {timesteps} of held-out timesteps"
        );
        let without_mask = capture.of(CaptureSplit::Train).filter(|view| view.mask.is_none()).count();
        if without_mask > 0 {
            log::warn!(
                "{without_mask} of {training} pictures have no mask: what is behind the head is learned as part of it, and \
                 `random_background` and `apply_masks` do nothing there. Give masks to `avatar import`, or take the pictures before a \
                 wall of the colour `background`"
            );
        }
        let gaussians = trainer.avatar().bound().len();
        log::info!(
            "{gaussians} Gaussians on the head model {}, {iterations} iterations, from iteration {}",
            trainer.avatar().model().name,
            trainer.iteration()
        );
        let facts = json!({ "gaussians": gaussians, "train": training, "val": camera, "test": timesteps });
        self.send("started", String::new(), facts);
    }

    fn step(&mut self, report: &StepReport) {
        self.done = report.iteration;
        let seconds = self.began.elapsed().as_secs_f64().max(1e-9);
        let mut message = format!("{:.1} iterations/s", (self.done - self.before) as f64 / seconds);
        let mut facts = Value::Null;
        if let Some(last) = &self.last {
            message += &format!(", loss {:.4}, {} Gaussians", last.loss, last.gaussians);
            facts = json!({ "loss": last.loss, "gaussians": last.gaussians });
        }
        self.send("step", message, facts);
    }

    fn send(&self, event: &str, message: String, facts: Value) {
        let mut facts = match facts {
            Value::Object(facts) => facts,
            _ => Map::new(),
        };
        facts.insert("event".to_owned(), json!(event));
        (self.watch.on_progress)(&Progress {
            done: self.done,
            total: Some(self.total),
            unit: "iterations".into(),
            message,
            facts,
        });
    }
}

fn log_scores(scores: &ScoresRecord) {
    let ratio = |ratio: Option<f64>| ratio.map_or("infinite".to_owned(), |db| format!("{db:.2} dB"));
    log::info!(
        "iteration {}: PSNR {} (mean of channels {}), SSIM {:.4} on {} pictures ({})",
        scores.iteration,
        ratio(scores.psnr),
        ratio(scores.psnr_channels),
        scores.ssim,
        scores.pictures,
        scores.split
    );
}
