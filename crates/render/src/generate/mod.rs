//! Generating an SRFlow dataset: heads in motion before moving cameras, with exact flow.
//!
//! The road: [`Settings`] become a plan ([`Manifest`]); the folder is claimed and what it lacks is listed; workers make it
//! pair by pair; a whole dataset gets its statistics. Every file's bytes depend on the settings alone: not on which part
//! it is made in, how often a run was killed, or how many threads there are.

mod background;
mod error;
mod folder;
mod occlusion;
mod path;
mod pictures;
mod rig;
mod scene;
mod settings;
mod timing;
mod work;

use std::io::Write;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize};
use std::time::Instant;

use rayon::prelude::*;
use srflow_field::write_atomically;

use crate::record::PairRecord;
use crate::statistics::{FlowSummary, Statistics};
use srflow_read::manifest::{Manifest, STATISTICS_NAME};

pub use background::Background;
pub use error::GenerateError;
pub use occlusion::DEPTH_TOLERANCE;
pub(crate) use path::Path as SmoothPath;
pub use pictures::DEPTH_UNITS_PER_METRE;
pub use rig::{CANONICAL_CAMERA, FULL_SIZE, Rig, View};
pub use settings::{Head, Settings, Shard};
pub use timing::{Stage, StageTime};

/// The most pairs in the making at once, each with about 0.3 GB of buffers at 2200x3208. More threads than that share
/// the pairs' work.
const MAX_WORKERS: usize = 16;

/// The most pairs that a worker takes at a time. After each run one frame is rendered twice.
const LONGEST_RUN: u32 = 24;

/// What [`generate`] tells while it works.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// The folder has been looked through.
    Started {
        /// Pairs of this part.
        pairs: u64,
        /// Those that are whole already.
        whole: u64,
    },
    /// One more pair is whole.
    PairWritten {
        /// Bytes that this run has written so far.
        bytes: u64,
    },
}

/// What [`generate`] did.
#[derive(Debug, Clone)]
pub struct Report {
    /// Pairs of this part.
    pub pairs: u64,
    /// Those that this run made.
    pub made: u64,
    /// Bytes that this run has written.
    pub bytes: u64,
    /// Seconds that making them took.
    pub seconds: f64,
    /// Where the workers' time went.
    pub stages: Vec<StageTime>,
    /// What the dataset holds; `None` while other parts of it are missing.
    pub statistics: Option<Statistics>,
}

/// Makes a dataset, or one part of it, in the folder `dir` with the threads of the current rayon pool. What is there
/// already, made with the same settings, is left as it is.
///
/// # Errors
/// Before any work when a setting is wrong or the folder is not this dataset's (`force` deletes another dataset there);
/// later when a file cannot be written or a background image not be read. What is complete stays, and the next call with
/// the same settings goes on from there.
pub fn generate(
    settings: &Settings,
    dir: &Path,
    shard: Shard,
    force: bool,
    on_event: &(dyn Fn(Event) + Sync),
) -> Result<Report, GenerateError> {
    let manifest = settings.plan()?;
    if let (Head::Ict(_), Some(entry)) = (&settings.head, manifest.scenes.first()) {
        scene::subject(&settings.head, entry)?; // before anything is written
    }
    folder::claim(dir, &manifest, force)?;
    let part = folder::pairs_of_shard(&manifest, shard);
    folder::tidy(dir, &manifest, &part)?;
    let pairs = count(&part);
    let missing = folder::missing(dir, &manifest, &part);
    let made = count(&missing);
    on_event(Event::Started { pairs, whole: pairs - made });

    let start = Instant::now();
    let work = work::Work {
        settings,
        manifest: &manifest,
        rig: &settings.rig(),
        dir,
        runs: &folder::cut(missing, run_length(made)),
        total: pairs,
        before: pairs - made,
        clock: &timing::Clock::default(),
        on_event,
        current_scene: Mutex::default(),
        next_run: AtomicUsize::new(0),
        written: AtomicU64::new(0),
        bytes: AtomicU64::new(0),
        stopped: AtomicBool::new(false),
    };
    work.make()?;
    let seconds = start.elapsed().as_secs_f64();
    let bytes = work.bytes.into_inner();
    let stages = work.clock.spent();
    Ok(Report { pairs, made, bytes, seconds, stages, statistics: finish(dir, &manifest)? })
}

fn count(runs: &[folder::Run]) -> u64 {
    runs.iter().map(|run| run.pairs.len() as u64).sum()
}

/// Runs as long as can be while every worker still gets several, so that all end at about the same time.
fn run_length(pairs: u64) -> u32 {
    let workers = rayon::current_num_threads().min(MAX_WORKERS) as u64;
    (pairs / (4 * workers)).clamp(1, u64::from(LONGEST_RUN)) as u32
}

/// Writes the statistics of a dataset that is whole.
fn finish(dir: &Path, manifest: &Manifest) -> Result<Option<Statistics>, GenerateError> {
    let everything = folder::pairs_of_shard(manifest, Shard::WHOLE);
    if !folder::missing(dir, manifest, &everything).is_empty() {
        return Ok(None);
    }
    let mut flow = FlowSummary::default();
    for run in &everything {
        let scene = &manifest.scenes[run.scene as usize];
        let records = run.pairs.clone().into_par_iter();
        let records = records.map(|pair| PairRecord::read(&manifest.files(dir, scene, pair).record));
        // Summed in order, so that the last bits do not depend on the threads.
        for record in records.collect::<Result<Vec<_>, _>>()? {
            flow.add(&record.flow);
        }
    }
    let statistics = Statistics::new(manifest, flow);
    write_atomically(&dir.join(STATISTICS_NAME), |writer| {
        serde_json::to_writer_pretty(&mut *writer, &statistics)?;
        writer.write_all(b"\n")
    })?;
    Ok(Some(statistics))
}
