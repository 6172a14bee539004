//! Protocols of recognition, each a name for a preparation and a classifier.

use srflow_core::{named, serialize_as_text};

use crate::classifier::ClassifierEntry;
use crate::extract::{FeatureSettings, ResizeOrder};
use crate::head_motion::HeadMotion;
use crate::strain::StrainFormula;

/// How clips are recognized where no setting says otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RecognitionProtocol {
    /// What recognizes most: flow at the frames' own size, averaged down, without the head's motion; the linear classifier.
    #[default]
    Srflow,
    /// The SRFlow paper's: flow between frames of 112x112, with the head's motion; Off-TANet.
    Paper,
}

named!(RecognitionProtocol, "a protocol", { Srflow => "srflow", Paper => "paper" });
serialize_as_text!(RecognitionProtocol);

impl RecognitionProtocol {
    pub fn features(self) -> FeatureSettings {
        let (resize, head_motion) = match self {
            Self::Srflow => (ResizeOrder::After, HeadMotion::Subtract),
            Self::Paper => (ResizeOrder::Before, HeadMotion::Keep),
        };
        FeatureSettings { resize, head_motion, strain: StrainFormula::Literature }
    }

    pub fn classifier(self) -> ClassifierEntry {
        match self {
            Self::Srflow => ClassifierEntry::LINEAR,
            Self::Paper => ClassifierEntry::OFF_TANET,
        }
    }
}

impl Default for FeatureSettings {
    /// Those of the default protocol.
    fn default() -> Self {
        RecognitionProtocol::default().features()
    }
}
