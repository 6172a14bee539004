//! Progress bars.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar on standard error with this many steps, where they are known; indicatif hides it when that is no terminal.
pub fn bar(steps: impl Into<Option<u64>>, template: &str) -> ProgressBar {
    let bar = steps.into().map_or_else(ProgressBar::no_length, ProgressBar::new);
    bar.with_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()))
}
