//! What packing produces.

use serde::{Deserialize, Serialize};

use crate::index::FlowStatistics;
use crate::settings::PackSettings;
use crate::source::Source;
use crate::split::SceneSplit;

/// The pairs of one tar.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Shard {
    pub split: SceneSplit,
    /// Its number within the split.
    pub number: u64,
    /// The first of its pairs, and how many it has.
    pub first: u64,
    pub count: u64,
}

impl Shard {
    pub fn name(&self) -> String {
        format!("{}-{:06}.tar", self.split, self.number)
    }
}

/// A whole tar.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct WholeTar {
    pub name: String,
    pub split: SceneSplit,
    /// Size in bytes.
    pub size: u64,
    pub sha256: String,
    pub pairs: u64,
    pub flow: FlowStatistics,
    pub flow_error: f32,
}

/// What the card and its like describe.
pub(crate) struct Packed<'a> {
    pub source: &'a Source,
    pub settings: PackSettings,
    pub tars: &'a [WholeTar],
    /// Ends of the names of every pair's members, such as `frame1.png`.
    pub fields: Vec<String>,
    /// Keys of the pairs that are shown.
    pub shown: Vec<String>,
}
