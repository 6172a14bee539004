//! Workers: each takes runs of units and renders them, until none is left, one fails, or the limit is reached.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use srflow_core::Recent;
use srflow_files::FileError;

use super::folder::until_kept;
use super::timing::{Clock, Stage};
use super::{Event, Layout as _, MAX_WORKERS, Plan, Request, Run};
use crate::RenderError;

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

    /// Whether to render another unit.
    pub fn begin(&self) -> bool {
        if self.begun.fetch_add(1, Ordering::Relaxed) >= self.stop_after || (self.stop)() {
            self.stopped.store(true, Ordering::Relaxed);
        }
        !self.stopped.load(Ordering::Relaxed)
    }

    /// Counts a unit with all files written.
    pub fn done(&self) {
        self.made.fetch_add(1, Ordering::Relaxed);
        (self.on_event)(Event::Made { bytes: self.bytes() });
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
