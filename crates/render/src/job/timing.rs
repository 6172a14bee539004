//! Timing by stage.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use srflow_core::named;

/// The stages of a worker's work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Creating subjects.
    Heads,
    /// Posing the head and moving its Gaussians.
    Motion,
    Rasterize,
    /// Masks, occlusion, statistics and backgrounds.
    Occlusion,
    /// Imaging effects, encoding and writing frames.
    Frames,
    /// Encoding and writing flow.
    Flow,
    /// Encoding and writing alpha, mask, occlusion and depth.
    Planes,
    /// Encoding and writing cameras and motion.
    Records,
}

named!(Stage, "a stage", {
    Heads => "heads",
    Motion => "motion",
    Rasterize => "rasterize",
    Occlusion => "occlusion",
    Frames => "frames",
    Flow => "flow",
    Planes => "planes",
    Records => "records",
});

/// Time of all workers together, by stage.
#[derive(Debug, Default)]
pub struct Clock {
    nanoseconds: [AtomicU64; Stage::ALL.len()],
}

impl Clock {
    /// Runs `work` and adds its time to `stage`.
    pub fn time<T>(&self, stage: Stage, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let spent = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds[stage as usize].fetch_add(spent, Ordering::Relaxed);
        result
    }

    /// Time so far, by stage.
    pub fn spent(&self) -> Vec<StageTime> {
        let of = |stage: Stage| {
            let nanoseconds = self.nanoseconds[stage as usize].load(Ordering::Relaxed);
            StageTime { stage: stage.name(), worker_seconds: Duration::from_nanos(nanoseconds).as_secs_f64() }
        };
        Stage::ALL.map(of).to_vec()
    }
}

/// Time of all workers together in one stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageTime {
    /// Name of the stage.
    pub stage: &'static str,
    /// Seconds, summed over the workers.
    pub worker_seconds: f64,
}
