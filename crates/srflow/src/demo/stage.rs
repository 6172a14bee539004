//! The stages of the demo: reported while they run, and timed for the report.

use std::time::Instant;

use serde::Serialize;

use crate::Watch;
use crate::watch::Count;

/// A finished stage.
#[derive(Debug, Clone, Serialize)]
pub struct StageTime {
    /// What was done.
    pub name: String,
    /// How long it took.
    pub seconds: f64,
}

/// The stages.
pub struct Stages<'a> {
    count: Count<'a>,
    /// The finished ones, in the order they ran.
    pub done: Vec<StageTime>,
}

impl<'a> Stages<'a> {
    /// `count` stages, none of them finished.
    pub fn of(count: u64, watch: &'a Watch) -> Self {
        Self { count: watch.count("stages", count), done: Vec::new() }
    }

    /// Runs one stage.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn run<T>(&mut self, name: &str, work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
        self.count.message(name);
        let start = Instant::now();
        let result = work()?;
        self.done.push(StageTime { name: name.to_owned(), seconds: start.elapsed().as_secs_f64() });
        self.count.set(self.done.len() as u64);
        Ok(result)
    }

    /// Seconds of all finished stages together.
    pub fn seconds(&self) -> f64 {
        seconds(&self.done)
    }
}

/// Seconds of these stages together.
pub fn seconds(stages: &[StageTime]) -> f64 {
    stages.iter().map(|stage| stage.seconds).sum()
}
