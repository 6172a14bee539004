//! What to render, and the workers that do: each takes runs of units and renders them, until none is left, one fails, or the
//! limit is reached.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use srflow_core::{Recent, Shard};
use srflow_files::FileError;

use super::layout::Layout;
use super::rewrite::until_kept;
use super::timing::{Clock, Stage};
use crate::RenderError;

/// Maximum number of units in progress at once, each with about 0.3 GB of buffers at 2200x3208. Further threads share the
/// units' work.
pub(super) const MAX_WORKERS: usize = 16;

/// A dataset that is rendered unit by unit. Units are grouped by something costly: a scene, a subject's head.
pub(crate) trait Plan: Sync + Sized {
    type Layout: Layout;
    type Group: Send + Sync;
    /// The buffers of one worker.
    type Worker;

    /// Maximum number of units in a run.
    const LONGEST_RUN: u32;

    fn layout(&self) -> &Self::Layout;

    /// The content of [`Layout::MANIFEST`].
    fn manifest(&self) -> String;

    /// The folders of a run's files.
    fn folders(&self, dir: &Path, run: &Run) -> Vec<PathBuf>;

    /// Whether the file called `name` in one of the run's folders belongs to the run.
    fn makes(&self, run: &Run, folder: &Path, name: &str) -> bool;

    /// Deletes only the files of a dataset whose manifest is `found`.
    fn delete(&self, dir: &Path, found: &str) -> Result<(), RenderError>;

    fn group(&self, number: u32) -> Result<Self::Group, RenderError>;

    fn worker(&self) -> Self::Worker;

    /// Renders the units of a run. Passes each to [`Work::each`].
    fn make(
        &self,
        work: &Work<'_, Self>,
        group: &Self::Group,
        run: &Run,
        worker: &mut Self::Worker,
    ) -> Result<(), RenderError>;
}

/// Consecutive units of one group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Run {
    pub group: u32,
    pub units: Range<u32>,
}

/// What to render of a dataset, and where.
#[derive(Clone, Copy)]
pub struct Request<'a> {
    pub dir: &'a Path,
    pub shard: Shard,
    /// Delete another dataset in the folder.
    pub force: bool,
    /// Stop after this many units.
    pub stop_after: Option<u64>,
    /// Asked before each unit, from any thread: whether to stop after those that are in progress.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    pub on_event: &'a (dyn Fn(Event) + Sync),
}

impl<'a> Request<'a> {
    /// The dataset, or the part of it to render.
    pub fn new(dir: &'a Path) -> Self {
        Self { dir, shard: Shard::WHOLE, force: false, stop_after: None, stop: &|| false, on_event: &|_| {} }
    }
}

/// Progress. Units are frame pairs or clips.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// Parts are brought together: so many units were found in them so far.
    Found { units: u64 },
    /// The files of so many units that several parts have were compared so far.
    Compared { units: u64 },
    /// The folder was scanned: `whole` of the shard's `units` already exist.
    Started { units: u64, whole: u64 },
    /// One more unit is complete; this run has written so many bytes.
    Made { bytes: u64 },
    /// The dataset is complete, and the files of so many of its units are hashed.
    Hashed { units: u64 },
}

/// State shared by all workers.
pub(crate) struct Work<'a, P: Plan> {
    pub plan: &'a P,
    pub dir: &'a Path,
    runs: &'a [Run],
    /// Number of units that existed before, and of all units of the shard.
    before: u64,
    total: u64,
    stop_after: u64,
    stop: &'a (dyn Fn() -> bool + Sync),
    on_event: &'a (dyn Fn(Event) + Sync),
    pub clock: Clock,
    /// The group that is rendered, and the next.
    groups: Recent<u32, P::Group>,
    next_run: AtomicUsize,
    begun: AtomicU64,
    made: AtomicU64,
    bytes: AtomicU64,
    stopped: AtomicBool,
}

impl<'a, P: Plan> Work<'a, P> {
    pub(super) fn new(
        plan: &'a P,
        request: &Request<'a>,
        runs: &'a [Run],
        (before, total): (u64, u64),
    ) -> Self {
        let Request { dir, stop_after, stop, on_event, .. } = *request;
        Self {
            plan,
            dir,
            runs,
            before,
            total,
            stop_after: stop_after.unwrap_or(u64::MAX),
            stop,
            on_event,
            clock: Clock::default(),
            groups: Recent::new(2),
            next_run: AtomicUsize::new(0),
            begun: AtomicU64::new(0),
            made: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            stopped: AtomicBool::new(stop_after == Some(0)),
        }
    }

    /// Renders all runs on the threads of the current rayon pool.
    ///
    /// # Errors
    /// The first error of any worker; the others stop after their current unit.
    pub(super) fn make(&self) -> Result<(), RenderError> {
        let threads = rayon::current_num_threads();
        let workers = threads.min(MAX_WORKERS).min(self.runs.len()).max(1);
        let pools = (0..workers).map(|worker| {
            // Leftover threads go to the first workers.
            let threads = threads / workers + usize::from(worker < threads % workers);
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .map_err(|error| RenderError::Threads { threads, reason: error.to_string() })
        });
        let pools: Vec<rayon::ThreadPool> = pools.collect::<Result<_, _>>()?;
        let first_error = Mutex::new(None);
        std::thread::scope(|scope| {
            for pool in &pools {
                scope.spawn(|| {
                    if let Err(error) = pool.install(|| self.work()) {
                        self.stopped.store(true, Ordering::Relaxed);
                        lock(&first_error).get_or_insert(error);
                    }
                });
            }
        });
        first_error.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }

    fn work(&self) -> Result<(), RenderError> {
        let mut worker = self.plan.worker();
        while !self.stopped.load(Ordering::Relaxed) {
            let number = self.next_run.fetch_add(1, Ordering::Relaxed);
            let Some(run) = self.runs.get(number) else { break };
            if self.is_second(number)
                && let Some(next) = self.group_after(run.group)
            {
                // While others make and render this group, so that nobody waits for the next. Its error is reported when it is rendered.
                _ = self.groups.try_get(next, || self.made_group(next));
            }
            let group = self.groups.get(run.group, || self.made_group(run.group))?;
            self.plan.make(self, &group, run, &mut worker)?;
        }
        Ok(())
    }

    fn made_group(&self, number: u32) -> Result<P::Group, RenderError> {
        self.clock.time(Stage::Heads, || self.plan.group(number))
    }

    /// Whether a run is the second of its group. Runs are taken in order.
    fn is_second(&self, number: usize) -> bool {
        let group = |number: usize| self.runs.get(number).map(|run| run.group);
        let before = |count| number.checked_sub(count).and_then(group);
        before(1) == group(number) && before(2) != group(number)
    }

    /// The group of the first run that is not of this group or one before.
    fn group_after(&self, number: u32) -> Option<u32> {
        self.runs.iter().map(|run| run.group).find(|group| *group > number)
    }

    /// Renders units one by one with `make`, until it is time to stop.
    ///
    /// # Errors
    /// The first error of `make`.
    pub fn each(
        &self,
        units: impl IntoIterator<Item = u32>,
        mut make: impl FnMut(u32) -> Result<(), RenderError>,
    ) -> Result<(), RenderError> {
        for unit in units {
            if !self.begin() {
                break;
            }
            make(unit)?;
            self.made.fetch_add(1, Ordering::Relaxed);
            (self.on_event)(Event::Made { bytes: self.bytes() });
        }
        Ok(())
    }

    /// Whether to render another unit.
    fn begin(&self) -> bool {
        if self.begun.fetch_add(1, Ordering::Relaxed) >= self.stop_after || (self.stop)() {
            self.stopped.store(true, Ordering::Relaxed);
        }
        !self.stopped.load(Ordering::Relaxed)
    }

    /// Writes a file and adds the time to `stage`.
    pub fn write(
        &self,
        stage: Stage,
        path: &Path,
        mut write: impl FnMut(&Path) -> Result<(), FileError>,
    ) -> Result<(), RenderError> {
        let written = self.clock.time(stage, || until_kept(|| write(path)));
        written.map_err(|error| RenderError::Write {
            error,
            written: self.before + self.made(),
            total: self.total,
            units: P::Layout::UNITS,
        })?;
        let size = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        self.bytes.fetch_add(size, Ordering::Relaxed);
        Ok(())
    }

    pub(super) fn made(&self) -> u64 {
        self.made.load(Ordering::Relaxed)
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panic in a worker ends the whole run; its data is not used again.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
