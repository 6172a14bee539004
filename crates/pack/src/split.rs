use serde::{Deserialize, Serialize};
use srflow_core::named;

/// The split of a scene, or of a pair without one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SceneSplit {
    Train,
    Val,
    Test,
}

named!(SceneSplit, "a split of scenes", { Train => "train", Val => "val", Test => "test" });
