use serde::{Deserialize, Serialize};
use srflow_core::named;
use srflow_pack::SceneSplit;

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

impl Split {
    /// The split of the scenes in it; `None` for all scenes.
    pub(super) fn of_scenes(self) -> Option<SceneSplit> {
        match self {
            Self::Train => Some(SceneSplit::Train),
            Self::Val => Some(SceneSplit::Val),
            Self::Test => Some(SceneSplit::Test),
            Self::All => None,
        }
    }
}
