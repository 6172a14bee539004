use std::path::PathBuf;

use serde::Serialize;

/// One problem of a dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The file or folder.
    pub file: PathBuf,
    pub what: String,
}
