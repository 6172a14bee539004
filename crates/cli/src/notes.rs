//! The libraries' notes, on standard error.

use log::{Level, LevelFilter, Log, Metadata, Record};

use crate::run::above_the_bar;

struct Notes;

/// Prints the libraries' notes from now on.
pub fn start() {
    // Another logger of the same process, such as Python's, keeps its place.
    if log::set_logger(&Notes).is_ok() {
        log::set_max_level(LevelFilter::Info);
    }
}

impl Log for Notes {
    fn enabled(&self, metadata: &Metadata) -> bool {
        metadata.level() <= Level::Info && metadata.target().starts_with("srflow")
    }

    fn log(&self, record: &Record) {
        if self.enabled(record.metadata()) {
            let prefix = if record.level() <= Level::Warn { "note: " } else { "" };
            above_the_bar(|| note!("{prefix}{}", record.args()));
        }
    }

    fn flush(&self) {}
}
