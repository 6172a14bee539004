use serde::{Deserialize, Serialize};
use srflow_field::named;

/// A part of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// For training.
    Train,
    /// For choosing among what was trained.
    Val,
    /// For the final score. Some benchmarks publish its frames without the truth.
    Test,
    /// Every pair that has a ground truth.
    All,
}

named!(Split, "a split", { Train => "train", Val => "val", Test => "test", All => "all" });
