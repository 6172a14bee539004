//! Workers: each takes runs of units and makes them, until none is left, one fails or enough are made.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use srflow_field::FileError;

use super::timing::{Clock, Stage};
use super::{Event, MAX_WORKERS, Plan, Run};
use crate::RenderError;

/// What all workers share.
pub(crate) struct Work<'a, P: Plan> {
    pub plan: &'a P,
    pub dir: &'a Path,
    runs: &'a [Run],
    /// Units that were there before, and all units of the shard.
    before: u64,
    total: u64,
    stop_after: u64,
    on_event: &'a (dyn Fn(Event) + Sync),
    pub clock: Clock,
    /// The group that work was last begun on.
    current: Mutex<Option<(u32, Arc<P::Group>)>>,
    next_run: AtomicUsize,
    begun: AtomicU64,
    made: AtomicU64,
    bytes: AtomicU64,
    stopped: AtomicBool,
}

impl<'a, P: Plan> Work<'a, P> {
    pub(super) fn new(
        plan: &'a P,
        dir: &'a Path,
        runs: &'a [Run],
        (before, total): (u64, u64),
        stop_after: Option<u64>,
        on_event: &'a (dyn Fn(Event) + Sync),
    ) -> Self {
        Self {
            plan,
            dir,
            runs,
            before,
            total,
            stop_after: stop_after.unwrap_or(u64::MAX),
            on_event,
            clock: Clock::default(),
            current: Mutex::default(),
            next_run: AtomicUsize::new(0),
            begun: AtomicU64::new(0),
            made: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            stopped: AtomicBool::new(stop_after == Some(0)),
        }
    }

    /// Makes all runs on the threads of the current rayon pool.
    ///
    /// # Errors
    /// The first that any worker meets; the others stop after the unit that they are at.
    pub(super) fn make(&self) -> Result<(), RenderError> {
        let threads = rayon::current_num_threads();
        let workers = threads.min(MAX_WORKERS).min(self.runs.len()).max(1);
        let pools = (0..workers).map(|worker| {
            // Threads that do not come out even go to the first workers.
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
        while !self.stopped.load(Ordering::Relaxed)
            && let Some(run) = self.runs.get(self.next_run.fetch_add(1, Ordering::Relaxed))
        {
            let group = self.group(run.group)?;
            self.plan.make(self, &group, run, &mut worker)?;
        }
        Ok(())
    }

    /// The group, which the workers that are at it share. Runs are taken in order: at most one group is begun at a time.
    fn group(&self, number: u32) -> Result<Arc<P::Group>, RenderError> {
        let mut current = lock(&self.current);
        if let Some((at, group)) = &*current
            && *at == number
        {
            return Ok(Arc::clone(group));
        }
        *current = None; // frees the group before, unless a worker is still at it
        let group = Arc::new(self.clock.time(Stage::Heads, || self.plan.group(number))?);
        *current = Some((number, Arc::clone(&group)));
        Ok(group)
    }

    /// Whether another unit is to be made.
    pub fn begin(&self) -> bool {
        if self.begun.fetch_add(1, Ordering::Relaxed) >= self.stop_after {
            self.stopped.store(true, Ordering::Relaxed);
        }
        !self.stopped.load(Ordering::Relaxed)
    }

    /// Counts a unit whose files are all written.
    pub fn done(&self) {
        self.made.fetch_add(1, Ordering::Relaxed);
        (self.on_event)(Event::Made { bytes: self.bytes() });
    }

    /// Writes a file on the account of `stage`.
    pub fn write(
        &self,
        stage: Stage,
        path: &Path,
        write: impl FnOnce(&Path) -> Result<(), FileError>,
    ) -> Result<(), RenderError> {
        self.clock.time(stage, || write(path)).map_err(|error| RenderError::Write {
            error,
            written: self.before + self.made(),
            total: self.total,
            units: P::UNITS,
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
    // A worker that panicked takes the whole run down; what it held is not looked at again.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
