//! Datasets that are made unit by unit, in parts, and continued: scenes, generic pairs, clips, captures.

use std::fmt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use serde_json::{Map, json};
use srflow_render::RenderError;
use srflow_render::job::{Event, Request};

use crate::Watch;
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::job_engine::{ShardChoice, TakenShard};
use crate::output::ensure_folder;
use crate::watch::Progress;

/// Which part of the work to do.
#[derive(Args, Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct ShardArgs {
    /// Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines,
    /// `auto/N` only I, as for Kubernetes and PBS
    #[arg(long, value_name = "I/N|auto", default_value_t, hide_default_value = true)]
    shard: ShardChoice,
}

impl ShardArgs {
    /// The part to do, by the environment of this process.
    ///
    /// # Errors
    /// Where `auto` has no answer.
    pub fn taken(self) -> anyhow::Result<TakenShard> {
        match self.shard.taken(&|name| std::env::var(name).ok()) {
            Ok(taken) => Ok(taken),
            Err(error) => wrong_settings!("{error}"),
        }
    }
}

/// How much of a dataset to render.
#[derive(Args, Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct RenderingArgs {
    #[command(flatten)]
    #[serde(flatten)]
    pub shard: ShardArgs,
    /// Stop after N pairs, clips or timesteps; the same command continues
    #[arg(long, value_name = "N")]
    pub stop_after: Option<u64>,
    /// Delete the dataset in the folder and start over
    #[arg(long)]
    pub force: bool,
}

impl RenderingArgs {
    /// Renders the dataset in `out` with `make`, and counts its `units`. Progress has the fact `bytes`: what was written.
    ///
    /// # Errors
    /// Those of `make`.
    #[doc(hidden)]
    pub fn make<T>(
        &self,
        out: &Path,
        units: &'static str,
        watch: &Watch,
        make: impl FnOnce(Request) -> Result<T, RenderError>,
    ) -> anyhow::Result<Rendered<T>> {
        ensure_folder(out)?;
        let shard = self.shard.taken()?;
        let count = Made::default();
        let on_event = |event| count.report(event, units, watch);
        let Self { force, stop_after, .. } = *self;
        let request = Request {
            dir: out,
            shard: shard.shard,
            force,
            stop_after,
            stop: watch.stop,
            on_event: &on_event,
        };
        Ok(Rendered { report: make(request)?, shard })
    }
}

/// What a run has made so far. Workers report at the same time; their reports go on one by one, in order.
#[derive(Default)]
pub(crate) struct Made(Mutex<Numbers>);

#[derive(Default)]
struct Numbers {
    done: u64,
    total: u64,
    bytes: u64,
}

impl Made {
    pub(crate) fn report(&self, event: Event, units: &'static str, watch: &Watch) {
        let mut numbers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut message = String::new();
        match event {
            Event::Started { units, whole } => {
                numbers.total = units;
                numbers.done = whole;
            }
            Event::Made { bytes } => {
                numbers.done += 1;
                numbers.bytes = numbers.bytes.max(bytes);
            }
            Event::Found { units } => message = format!("{units} found in the parts"),
            Event::Compared { units } => message = format!("{units} in several parts compared"),
            Event::Hashed { units } => message = format!("{units} hashed"),
        }
        let Numbers { done, total, bytes } = *numbers;
        if message.is_empty() && bytes > 0 {
            message = format!("{:.1} MB", bytes as f64 / 1e6);
        }
        (watch.on_progress)(&Progress {
            done,
            total: Some(total),
            unit: units.into(),
            message,
            facts: Map::from_iter([("bytes".to_owned(), json!(bytes))]),
        });
    }
}

/// What a run has made, and of which part.
#[derive(Debug, Clone, Serialize)]
pub struct Rendered<T> {
    #[serde(flatten)]
    pub report: T,
    pub shard: TakenShard,
}

impl<T> Rendered<T> {
    pub(crate) fn map<U>(self, summary: impl FnOnce(T) -> U) -> Rendered<U> {
        Rendered { report: summary(self.report), shard: self.shard }
    }

    /// Says how the parts become one dataset, which lacks its `files` of the whole so far.
    pub(crate) fn write_part(&self, f: &mut fmt::Formatter, files: &str) -> fmt::Result {
        let TakenShard { shard, from } = &self.shard;
        let by = if from.is_empty() { String::new() } else { format!(" ({})", from.join(", ")) };
        writeln!(
            f,
            "Part {shard}{by} is complete. `srflow merge` joins parts and writes {files}; so does the last part in a shared folder."
        )
    }
}
