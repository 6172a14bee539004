use std::fmt;

use serde::Serialize;

/// The annotation of one clip.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Annotation {
    /// The subject, spelled as in the dataset: `006` is not `6`.
    pub subject: String,
    /// The clip's name; other subjects may have a clip of the same name.
    pub clip: String,
    /// Index of its class in [`Classes`](super::Classes).
    pub class: usize,
    /// The dataset's label, e.g. `repression`.
    pub label: String,
    /// Action units as coded, e.g. `R2+15`; empty without coding.
    pub action_units: String,
    /// Number of the first frame of the expression.
    pub onset: u64,
    /// Number of the apex frame, if known; after the onset.
    pub apex: Option<u64>,
    /// Number of its last frame.
    pub offset: u64,
}

/// A dropped row of the annotations.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dropped {
    pub subject: String,
    pub clip: String,
    pub label: String,
    pub reason: DropReason,
}

/// Why a row is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DropReason {
    Label,
    SeveralClasses,
    FramesUnknown,
    FramesOutOfOrder,
    ApexUnknown,
    ApexNotAfterOnset,
    NotInApexList,
    FramesMissing,
}

impl fmt::Display for DropReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Label => "the label belongs to none of the classes",
            Self::SeveralClasses => "its emotions belong to several classes, or one of them to none",
            Self::FramesUnknown => "the onset or offset is not a frame number",
            Self::FramesOutOfOrder => "the offset is not after the onset",
            Self::ApexUnknown => "the apex is not a frame number",
            Self::ApexNotAfterOnset => "the apex is not after the onset",
            Self::NotInApexList => "not one of the 157 clips of the published apex list",
            Self::FramesMissing => "the onset or apex frame is missing",
        })
    }
}
