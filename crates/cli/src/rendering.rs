//! Datasets that are made unit by unit, in parts, and continued: `srflow render`, `srflow shapes`, `srflow mer synth` ...

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::job_engine::{ShardChoice, TakenShard};
use clap::Args;
use indicatif::ProgressBar;
use serde::Serialize;
use serde_json::json;
use srflow_render::RenderError;
use srflow_render::job::{Event, Request};

use crate::interrupt::{self, Continuable};
use crate::library::Watch;
use crate::output::{ensure_folder, exit_stopped, print_json};
use crate::progress::{Lines, bar};
use crate::usage::wrong_usage;

/// Which part of the work to do.
#[derive(Args, Clone, Copy, Default)]
pub struct ShardArgs {
    /// Do only part I of N; `auto` takes the part of this job or process from the variables of Slurm, Kubernetes and other job engines,
    /// `auto/N` where they do not tell how many parts there are (docs/guides/clusters.md)
    #[arg(long, value_name = "I/N|auto", default_value = "1/1", hide_default_value = true)]
    shard: ShardChoice,
}

impl ShardArgs {
    /// The part to do, by the environment of this process.
    ///
    /// # Errors
    /// [`UsageError`](crate::UsageError) where `auto` has no answer.
    pub fn taken(self) -> anyhow::Result<TakenShard> {
        match self.shard.taken(&|name| std::env::var(name).ok()) {
            Ok(taken) => Ok(taken),
            Err(error) => wrong_usage!("{error}"),
        }
    }
}

/// How much of a dataset to render.
#[derive(Args, Default)]
pub struct RenderingArgs {
    #[command(flatten)]
    pub shard: ShardArgs,
    /// Stop after rendering N pairs, clips or timesteps, with exit code 75; the same command continues
    #[arg(long, value_name = "N")]
    pub stop_after: Option<u64>,
    /// Delete the dataset in the folder and start over
    #[arg(long)]
    pub force: bool,
}

impl RenderingArgs {
    /// Renders the dataset in `out` with `make`, with a progress bar for its `units`.
    ///
    /// # Errors
    /// Those of `make`; an argument out of range is wrong usage.
    pub fn make<T>(
        &self,
        out: &Path,
        units: &str,
        make: impl FnOnce(Request) -> Result<T, RenderError>,
    ) -> anyhow::Result<Rendered<T>> {
        let shard = self.shard.taken()?;
        let progress = Progress::new(units);
        let continuable = Continuable::counted(&progress.bar, units);
        let made = self.make_with(out, &shard, &|event| progress.show(event), &interrupt::requested, make);
        drop(continuable);
        progress.bar.finish_and_clear();
        Ok(Rendered { report: made?, shard })
    }

    /// Renders the dataset in `out` with `make`. Progress has the key `bytes` too: what was written.
    ///
    /// # Errors
    /// As [`RenderingArgs::make`].
    pub fn make_watched<T>(
        &self,
        out: &Path,
        watch: &Watch,
        make: impl FnOnce(Request) -> Result<T, RenderError>,
    ) -> anyhow::Result<Rendered<T>> {
        let shard = self.shard.taken()?;
        let state = Mutex::new((0, 0, 0));
        let on_event = |event| {
            // Workers report at the same time: what is done only grows.
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            let (done, total, written) = *state;
            *state = match event {
                Event::Started { units, whole } => (whole, units, written),
                Event::Made { bytes } => (done + 1, total, written.max(bytes)),
                Event::Found { .. } | Event::Compared { .. } | Event::Hashed { .. } => return,
            };
            let (done, total, bytes) = *state;
            (watch.on_progress)(json!({ "done": done, "total": total, "bytes": bytes }));
        };
        let report = self.make_with(out, &shard, &on_event, watch.stop, make)?;
        Ok(Rendered { report, shard })
    }

    fn make_with<T>(
        &self,
        out: &Path,
        shard: &TakenShard,
        on_event: &(dyn Fn(Event) + Sync),
        stop: &(dyn Fn() -> bool + Sync),
        make: impl FnOnce(Request) -> Result<T, RenderError>,
    ) -> anyhow::Result<T> {
        ensure_folder(out)?;
        let Self { force, stop_after, .. } = *self;
        match make(Request { dir: out, shard: shard.shard, force, stop_after, stop, on_event }) {
            Err(error @ RenderError::Argument { .. }) => wrong_usage!("{error}"),
            made => Ok(made?),
        }
    }
}

/// What a run has made, of which part.
#[derive(Serialize)]
pub struct Rendered<T> {
    #[serde(flatten)]
    pub report: T,
    pub shard: TakenShard,
}

impl<T: Serialize> Rendered<T> {
    pub fn print_json(&self) -> anyhow::Result<()> {
        print_json(self)
    }
}

impl<T> Rendered<T> {
    /// Says how the parts become one dataset, whose `files` of the whole are not there yet.
    pub fn print_part(&self, files: &str) -> anyhow::Result<()> {
        let TakenShard { shard, from } = &self.shard;
        let by = if from.is_empty() { String::new() } else { format!(" ({})", from.join(", ")) };
        say!(
            "Part {shard}{by} is complete. `srflow merge` brings parts together and writes {files}; so does the last part in a shared folder."
        )
    }

    pub fn map<U>(self, of: impl FnOnce(&T) -> U) -> Rendered<U> {
        Rendered { report: of(&self.report), shard: self.shard }
    }
}

/// Exits the program if the run was stopped on request.
pub fn exit_if_stopped(stopped: bool) -> anyhow::Result<()> {
    if stopped {
        match interrupt::requested() {
            true => note!("stopped by a signal; the same command continues"),
            false => note!("stopped on request; the same command without --stop-after continues"),
        }
        exit_stopped()?;
    }
    Ok(())
}

/// A bar for units that are made; lines where it is not seen.
pub struct Progress {
    pub bar: ProgressBar,
    units: String,
    lines: Lines,
    bytes: AtomicU64,
}

impl Progress {
    pub fn new(units: &str) -> Self {
        let template = format!("{{wide_bar}} {{pos}}/{{len}} {units}, {{msg}}, {{eta}} left");
        Self {
            bar: bar(0, &template),
            units: units.to_owned(),
            lines: Lines::new(),
            bytes: AtomicU64::new(0),
        }
    }

    pub fn show(&self, event: Event) {
        match event {
            Event::Found { units } => self.bar.set_message(format!("{units} found in the parts")),
            Event::Compared { units } => {
                self.bar.set_message(format!("{units} that several parts have compared"));
            }
            Event::Started { units, whole } => {
                self.bar.set_message("");
                self.bar.set_length(units);
                self.bar.set_position(whole);
                self.bar.reset_eta();
                self.bar.reset_elapsed();
            }
            Event::Made { bytes } => {
                // Workers report out of order: keep the highest count.
                let bytes = self.bytes.fetch_max(bytes, Ordering::Relaxed).max(bytes);
                let seconds = self.bar.elapsed().as_secs_f64().max(1e-3);
                self.bar.set_message(format!("{:.1} MB/s", bytes as f64 / 1e6 / seconds));
                self.bar.inc(1);
            }
            Event::Hashed { units } => self.bar.set_message(format!("{units} hashed")),
        }
        self.lines.now_and_then(&self.bar, &self.units);
    }
}
