//! Progress of a job, and a way to stop it.

use std::borrow::Cow;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;
use serde_json::{Map, Value};

/// Follows a job: gets its progress, and says whether it should stop. Both functions are called from any thread.
///
/// Notes that need no answer, such as a weights file that fits two networks, go to the crate `log`.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    pub on_progress: &'a (dyn Fn(&Progress) + Sync),
    /// A job that is resumable stops in order when this returns `true`; running it again continues.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl Watch<'static> {
    /// Reports nothing and never stops.
    pub const SILENT: Self = Watch { on_progress: &|_| {}, stop: &|| false };
}

/// How far a stage of a job is.
#[derive(Debug, Clone, Serialize)]
pub struct Progress {
    /// Finished units.
    pub done: u64,
    /// All units, where their number is known.
    pub total: Option<u64>,
    /// What is counted: `pairs`, `steps`. Another unit begins another stage.
    #[serde(skip)]
    pub unit: Cow<'static, str>,
    /// What happens now, in a few words; may be empty.
    #[serde(skip)]
    pub message: String,
    /// Facts for programs, such as `bytes` written or the `loss` of a step.
    #[serde(flatten)]
    pub facts: Map<String, Value>,
}

impl Watch<'_> {
    /// A stage that counts `unit`s, starting at zero.
    pub(crate) fn count(
        &self,
        unit: impl Into<Cow<'static, str>>,
        total: impl Into<Option<u64>>,
    ) -> Count<'_> {
        let count = Count {
            watch: *self,
            unit: unit.into(),
            done: AtomicU64::new(0),
            total: AtomicU64::new(total.into().unwrap_or(UNKNOWN)),
            message: Mutex::default(),
        };
        count.report();
        count
    }

    pub(crate) fn stops(&self) -> bool {
        (self.stop)()
    }
}

/// The total of a stage that does not know it.
const UNKNOWN: u64 = u64::MAX;

/// A stage of a job; may be shared by threads.
pub(crate) struct Count<'a> {
    watch: Watch<'a>,
    unit: Cow<'static, str>,
    done: AtomicU64,
    total: AtomicU64,
    message: Mutex<String>,
}

impl Count<'_> {
    /// One more unit is done.
    pub fn inc(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
        self.report();
    }

    /// So many more units are done.
    pub fn add(&self, units: u64) {
        self.done.fetch_add(units, Ordering::Relaxed);
        self.report();
    }

    /// So many units are done.
    pub fn set(&self, done: u64) {
        self.done.store(done, Ordering::Relaxed);
        self.report();
    }

    pub fn set_total(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
        self.report();
    }

    /// What happens now.
    pub fn message(&self, message: impl Into<String>) {
        *self.message.lock().unwrap_or_else(PoisonError::into_inner) = message.into();
        self.report();
    }

    fn report(&self) {
        let total = self.total.load(Ordering::Relaxed);
        let message = self.message.lock().unwrap_or_else(PoisonError::into_inner).clone();
        (self.watch.on_progress)(&Progress {
            done: self.done.load(Ordering::Relaxed),
            total: (total != UNKNOWN).then_some(total),
            unit: self.unit.clone(),
            message,
            facts: Map::new(),
        });
    }
}
