//! Errors in the arguments themselves.

use std::fmt;

/// An error in the arguments: the program exits with code 2.
#[derive(Debug)]
pub struct UsageError(pub String);

impl fmt::Display for UsageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

/// Returns a [`UsageError`] from a function that returns `anyhow::Result`.
macro_rules! wrong_usage {
    ($($text:tt)*) => { return Err(crate::usage::UsageError(format!($($text)*)).into()) };
}

pub(crate) use wrong_usage;
