//! What a kind of file is.

use std::path::Path;

use super::Intervals;
use crate::micro_expression::MicroExpressionError;

/// A kind of file with intervals.
#[derive(Debug)]
pub struct IntervalKind {
    /// The name in `KIND:FILE`.
    pub name: &'static str,
    /// Title in the help.
    pub about: &'static str,
    pub(super) read: fn(&Path) -> Result<Intervals, MicroExpressionError>,
}
