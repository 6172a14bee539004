//! Progress bars.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// A bar on standard error with this many steps, where they are known; indicatif hides it when that is no terminal.
pub fn bar(steps: impl Into<Option<u64>>, template: &str) -> ProgressBar {
    let bar = steps.into().map_or_else(ProgressBar::no_length, ProgressBar::new);
    bar.with_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// Time between two lines in the logs of job engines.
const LOGGED_APART: Duration = Duration::from_secs(60);
/// Time between two lines of training.
const LINES_APART: Duration = Duration::from_secs(30);

/// Lines about work whose bar nobody sees, since standard error is no terminal: for the logs of job engines.
pub struct Lines {
    began: Instant,
    /// When the last one was printed, or the work began.
    printed: Mutex<Instant>,
}

impl Lines {
    pub fn new() -> Self {
        let began = Instant::now();
        Self { began, printed: Mutex::new(began) }
    }

    /// Prints how many of its `units` the bar counts, and its message, if the last line is old enough. May be called from any thread.
    pub fn now_and_then(&self, bar: &ProgressBar, units: &str) {
        // Another thread that holds the lock is about to print.
        let Ok(mut printed) = self.printed.try_lock() else { return };
        if printed.elapsed() < LOGGED_APART || !bar.is_hidden() {
            return;
        }
        *printed = Instant::now();
        drop(printed);
        note!("{}", line(bar.position(), bar.length(), units, &bar.message(), bar.eta()));
    }

    /// Prints the step that a training is at, and the bar's message, if it is the first or the last step or the last line is old
    /// enough.
    pub fn of_training(&self, bar: &ProgressBar, units: &str) {
        let Ok(mut printed) = self.printed.try_lock() else { return };
        let (step, steps) = (bar.position(), bar.length().unwrap_or_default());
        let due = *printed == self.began || printed.elapsed() >= LINES_APART || step == steps;
        if !due || !bar.is_hidden() {
            return;
        }
        *printed = Instant::now();
        drop(printed);
        let unit = units.strip_suffix('s').unwrap_or(units);
        let minutes = bar.eta().as_secs_f64() / 60.0;
        note!("{unit} {step}/{steps}: {}, {minutes:.0} min left", bar.message());
    }
}

fn line(position: u64, length: Option<u64>, units: &str, message: &str, left: Duration) -> String {
    let counted = match length {
        Some(0) => String::new(),
        Some(all) => format!("{position} of {all} {units}"),
        None => format!("{position} {units}"),
    };
    let left = match left.as_secs() {
        0 => String::new(),
        seconds => format!("{} min left", seconds.div_ceil(60)),
    };
    let parts = [counted.as_str(), message, &left];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_count() {
        let minutes = |minutes: u64| Duration::from_secs(60 * minutes);
        assert_eq!(line(2, Some(9), "pairs", "0.1 MB/s", minutes(3)), "2 of 9 pairs, 0.1 MB/s, 3 min left");
        assert_eq!(line(2, None, "pairs of srflow:d listed", "", minutes(0)), "2 pairs of srflow:d listed");
        assert_eq!(line(0, Some(0), "pairs", "7 found", minutes(0)), "7 found");
    }
}
