//! The stages of the demo: announced while they run, and timed for the report.

use std::io::IsTerminal;
use std::time::Instant;

use serde::Serialize;

/// A finished stage.
#[derive(Debug, Clone, Serialize)]
pub struct StageTime {
    /// What was done.
    pub name: String,
    /// How long it took.
    pub seconds: f64,
}

/// The finished stages.
#[derive(Debug)]
pub struct Stages {
    /// Total number of stages, for `2/5`.
    count: usize,
    /// In the order they ran.
    pub done: Vec<StageTime>,
}

impl Stages {
    /// `count` stages, none of them finished.
    pub fn of(count: usize) -> Self {
        Self { count, done: Vec::new() }
    }

    /// Runs one stage, and announces it on standard error if that is a terminal.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn run<T>(&mut self, name: &str, work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
        if std::io::stderr().is_terminal() {
            note!("{}/{}  {name}", self.done.len() + 1, self.count);
        }
        let start = Instant::now();
        let result = work()?;
        self.done.push(StageTime { name: name.to_owned(), seconds: start.elapsed().as_secs_f64() });
        Ok(result)
    }

    /// Seconds of all stages together.
    pub fn seconds(&self) -> f64 {
        self.done.iter().map(|stage| stage.seconds).sum()
    }
}
