//! Datasets that are made unit by unit, in parts, and continued: `srflow render`, `srflow shapes`, `srflow mer synth` ...

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use clap::Args;
use indicatif::ProgressBar;
use serde_json::json;
use srflow_render::RenderError;
use srflow_render::job::{Event, Request, Shard};

use crate::library::Watch;
use crate::output::{ensure_folder, exit_stopped};
use crate::progress::bar;
use crate::usage::wrong_usage;

/// How much of a dataset to render.
#[derive(Args, Default)]
pub struct RenderingArgs {
    /// Render only part I of N
    #[arg(long, value_name = "I/N", default_value = "1/1", hide_default_value = true)]
    pub shard: Shard,
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
    ) -> anyhow::Result<T> {
        let progress = Progress::new(units);
        let made = self.make_with(out, &|event| progress.show(event), &|| false, make);
        progress.bar.finish_and_clear();
        made
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
    ) -> anyhow::Result<T> {
        let state = Mutex::new((0, 0, 0));
        let on_event = |event| {
            // Workers report at the same time: what is done only grows.
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            let (done, total, written) = *state;
            *state = match event {
                Event::Started { units, whole } => (whole, units, written),
                Event::Made { bytes } => (done + 1, total, written.max(bytes)),
            };
            let (done, total, bytes) = *state;
            (watch.on_progress)(json!({ "done": done, "total": total, "bytes": bytes }));
        };
        self.make_with(out, &on_event, watch.stop, make)
    }

    fn make_with<T>(
        &self,
        out: &Path,
        on_event: &(dyn Fn(Event) + Sync),
        stop: &(dyn Fn() -> bool + Sync),
        make: impl FnOnce(Request) -> Result<T, RenderError>,
    ) -> anyhow::Result<T> {
        ensure_folder(out)?;
        let Self { shard, force, stop_after } = *self;
        match make(Request { dir: out, shard, force, stop_after, stop, on_event }) {
            Err(error @ RenderError::Argument { .. }) => wrong_usage!("{error}"),
            made => Ok(made?),
        }
    }
}

/// Exits the program if the run was stopped on request.
pub fn exit_if_stopped(stopped: bool) -> anyhow::Result<()> {
    if stopped {
        note!("stopped on request; the same command without --stop-after continues");
        exit_stopped()?;
    }
    Ok(())
}

struct Progress {
    bar: ProgressBar,
    bytes: AtomicU64,
}

impl Progress {
    fn new(units: &str) -> Self {
        let template = format!("{{wide_bar}} {{pos}}/{{len}} {units}, {{msg}}, {{eta}} left");
        Self { bar: bar(0, &template), bytes: AtomicU64::new(0) }
    }

    fn show(&self, event: Event) {
        match event {
            Event::Started { units, whole } => {
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
        }
    }
}
