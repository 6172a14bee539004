//! The table of kinds of files.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use super::kind::IntervalKind;
use super::{Intervals, casme_squared, casme3, csv_file, samm_long};
use crate::micro_expression::MicroExpressionError;

pub static INTERVAL_KINDS: [IntervalKind; 4] =
    [csv_file::KIND, casme_squared::KIND, samm_long::KIND, casme3::KIND];

/// A file with intervals, as in `KIND:FILE`; without a kind it is a CSV file.
#[derive(Debug, Clone)]
pub struct IntervalSource {
    pub kind: &'static IntervalKind,
    pub path: PathBuf,
}

impl IntervalSource {
    /// Reads the file.
    ///
    /// # Errors
    /// When it cannot be read, or one of its rows has other values than numbers of frames in order.
    pub fn read(&self) -> Result<Intervals, MicroExpressionError> {
        (self.kind.read)(&self.path)
    }
}

impl PartialEq for IntervalSource {
    fn eq(&self, other: &Self) -> bool {
        self.kind.name == other.kind.name && self.path == other.path
    }
}

impl FromStr for IntervalSource {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let kind = |name: &str| INTERVAL_KINDS.iter().find(|kind| kind.name == name);
        Ok(match text.split_once(':').and_then(|(name, file)| Some((kind(name)?, file))) {
            Some((kind, file)) => Self { kind, path: file.into() },
            None => Self { kind: &INTERVAL_KINDS[0], path: text.into() },
        })
    }
}

impl fmt::Display for IntervalSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.kind.name, self.path.display())
    }
}

srflow_core::serialize_as_text!(IntervalSource);
