//! Progress bars.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// A bar on standard error with this many steps, where they are known; indicatif hides it when that is no terminal.
pub fn bar(steps: impl Into<Option<u64>>, template: &str) -> ProgressBar {
    let bar = steps.into().map_or_else(ProgressBar::no_length, ProgressBar::new);
    bar.with_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Progress of a training: a bar on standard error if that is a terminal; otherwise a line now and then.
pub struct TrainingProgress {
    bar: ProgressBar,
    /// What is counted, e.g. `step`.
    unit: &'static str,
    /// Done before this process.
    done: u64,
    steps: u64,
    began: Instant,
    /// When the last line was printed, without a bar.
    printed: Option<Instant>,
}

/// Time between two lines when standard error is no terminal.
const LINES_APART: Duration = Duration::from_secs(30);

impl TrainingProgress {
    pub fn new(unit: &'static str) -> Self {
        let bar = bar(0, "{bar:24} {pos}/{len} {msg}, {eta} left");
        Self { bar, unit, done: 0, steps: 0, began: Instant::now(), printed: None }
    }

    /// A training of `steps` steps begins after the first `done`.
    pub fn start(&mut self, done: u64, steps: u64) {
        self.bar.set_length(steps);
        self.bar.set_position(done);
        self.bar.reset_eta();
        (self.done, self.steps, self.began, self.printed) = (done, steps, Instant::now(), None);
    }

    /// Shows that `step` is done, and what `words` says of it, given the steps per second. The first step and the last are always
    /// printed.
    pub fn advance(&mut self, step: u64, words: impl FnOnce(f64) -> String) {
        let rate = (step - self.done) as f64 / self.began.elapsed().as_secs_f64().max(1e-9);
        self.bar.set_position(step);
        if !self.bar.is_hidden() {
            self.bar.set_message(words(rate));
            return;
        }
        let due = self.printed.is_none_or(|printed| printed.elapsed() >= LINES_APART);
        if due || step == self.steps {
            self.printed = Some(Instant::now());
            let minutes = (self.steps - step) as f64 / rate.max(1e-9) / 60.0;
            self.line(&format!(
                "{} {step}/{}: {}, {minutes:.0} min left",
                self.unit,
                self.steps,
                words(rate)
            ));
        }
    }

    /// Counts a step of which there is nothing to say.
    pub fn skip(&self, step: u64) {
        self.bar.set_position(step);
    }

    /// What is done besides steps, on the bar.
    pub fn message(&self, words: String) {
        self.bar.set_message(words);
    }

    pub fn line(&self, text: &str) {
        self.bar.suspend(|| note!("{text}"));
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}
