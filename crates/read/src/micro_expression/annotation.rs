use std::fmt;

use serde::Serialize;

/// What is known of one clip: who, what and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Annotation {
    /// The subject as the dataset writes it: `006` is not `6`.
    pub subject: String,
    /// The clip's name. It may be another subject's clip's name too.
    pub clip: String,
    /// Number of its class among [`Classes`](super::Classes).
    pub class: usize,
    /// The label that the dataset gives, e.g. `repression`.
    pub label: String,
    /// Action units as they were coded, e.g. `R2+15`; empty where they were not.
    pub action_units: String,
    /// Number of the first frame of the expression.
    pub onset: u64,
    /// Number of the frame of its greatest strength, where it is known; after the onset.
    pub apex: Option<u64>,
    /// Number of its last frame.
    pub offset: u64,
}

/// A row of the annotations that is left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dropped {
    pub subject: String,
    pub clip: String,
    /// The label that the dataset gives.
    pub label: String,
    pub reason: DropReason,
}

/// Why a row is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DropReason {
    /// It belongs to none of the classes.
    Label,
    /// Its apex is no frame number.
    ApexUnknown,
    /// Its apex is the onset or comes before it.
    ApexNotAfterOnset,
    /// SMIC: not one of the 157 clips of the published apex list.
    NotInApexList,
    /// Its onset or apex frame is not on disk.
    FramesMissing,
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Label => "the label belongs to none of the classes",
            Self::ApexUnknown => "the apex is not a frame number",
            Self::ApexNotAfterOnset => "the apex does not come after the onset",
            Self::NotInApexList => "not one of the 157 clips of the published apex list",
            Self::FramesMissing => "the onset or apex frame is missing",
        })
    }
}
