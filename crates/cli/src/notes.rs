//! The libraries' notes, on standard error.

use std::sync::OnceLock;

use log::{Level, LevelFilter, Log, Metadata, Record};

use crate::run::above_the_bar;
use crate::usage::with_options;

struct Notes;

/// The long options of the command, which stand for the settings that notes name.
static OPTIONS: OnceLock<Vec<String>> = OnceLock::new();

/// Prints the libraries' notes from now on, for a command with these options.
pub fn start(options: &[String]) {
    _ = OPTIONS.set(options.to_vec());
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
            let options = OPTIONS.get().map(Vec::as_slice).unwrap_or_default();
            let text = with_options(record.args().to_string(), options);
            above_the_bar(|| note!("{prefix}{text}"));
        }
    }

    fn flush(&self) {}
}
