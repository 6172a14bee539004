//! The stages of the demo: announced while they run, timed for the report.

use std::io::IsTerminal;
use std::time::Instant;

use serde::Serialize;

/// How many stages there are, for `2/5`.
const STAGES: usize = 6;

/// One stage that is over.
#[derive(Debug, Clone, Serialize)]
pub struct StageTime {
    /// What was done.
    pub name: String,
    /// How long it took.
    pub seconds: f64,
}

/// The stages that are over.
#[derive(Debug, Default)]
pub struct Stages {
    /// In the order in which they ran.
    pub done: Vec<StageTime>,
}

impl Stages {
    /// Runs one stage, announced on standard error where that is a terminal.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn run<T>(&mut self, name: &str, work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
        if std::io::stderr().is_terminal() {
            eprintln!("{}/{STAGES}  {name}", self.done.len() + 1);
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
