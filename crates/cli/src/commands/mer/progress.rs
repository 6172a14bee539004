//! Progress of `srflow mer run`.

use std::sync::{Mutex, PoisonError};

use indicatif::ProgressBar;
use srflow_mer::RunEvent;

use crate::progress::bar;

/// One bar for each part of a run, one after another.
pub struct RunProgress {
    bar: Mutex<ProgressBar>,
}

impl Default for RunProgress {
    fn default() -> Self {
        Self { bar: Mutex::new(ProgressBar::hidden()) }
    }
}

impl RunProgress {
    /// Updates the bar.
    pub fn show(&self, event: RunEvent) {
        let mut bar = self.bar.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            RunEvent::Apexes { clips } => {
                *bar = next(&bar, clips as u64, "apexes {bar:30} {pos}/{len}, ETA {eta}")
            }
            RunEvent::Features { method, clips } => {
                *bar = next(&bar, clips as u64, "{msg}: features {bar:30} {pos}/{len}, ETA {eta}");
                bar.set_message(method.to_owned());
            }
            RunEvent::Clip => bar.inc(1),
            RunEvent::Training { clip_epochs } => {
                let template = "{msg}: training {bar:30} {percent}% in {elapsed}, ETA {eta}";
                *bar = next(&bar, clip_epochs, template);
                bar.set_message("classifiers");
            }
            RunEvent::Folds { set, method } => bar.set_message(format!("{set}, {method}")),
            RunEvent::Trained { clip_epochs } => bar.inc(clip_epochs),
            RunEvent::Resumed { clip_epochs } => {
                bar.inc(clip_epochs);
                bar.reset_eta(); // loading finished folds is faster than training
            }
        }
    }

    /// Removes the last bar.
    pub fn finish(&self) {
        self.bar.lock().unwrap_or_else(PoisonError::into_inner).finish_and_clear();
    }
}

fn next(last: &ProgressBar, length: u64, template: &str) -> ProgressBar {
    last.finish_and_clear();
    bar(length, template)
}
