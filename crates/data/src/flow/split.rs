use serde::{Deserialize, Serialize};
use srflow_core::named;

/// A part of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    Train,
    Val,
    /// For the final score. Some benchmarks publish its frames without ground truth.
    Test,
    /// Every pair with ground truth.
    All,
}

named!(Split, "a split", { Train => "train", Val => "val", Test => "test", All => "all" });
