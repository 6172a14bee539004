//! How frames become features.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::ClipDataset;
use srflow_mer::{
    ApexRule, FeatureSettings, HeadMotion, Preparation, RecognitionProtocol, ResizeOrder, StrainFormula,
};

use crate::Watch;
use crate::clap::Args;
use crate::face::FaceArgs;

/// How frames become features.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PreparationArgs {
    /// How to spot the apex of clips without one: course, strain or ratio
    #[arg(long, value_name = "RULE")]
    pub apex: Option<ApexRule>,
    /// Formula of the optical strain: literature or off-tanet
    #[arg(long, value_name = "FORMULA", default_value_t)]
    pub strain: StrainFormula,
    /// Protocol: srflow (what recognizes most) or paper (the SRFlow paper's) [default: srflow; paper for --rows
    /// paper-tables-7-to-10]
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Option<RecognitionProtocol>,
    /// Resize to 112x112: the frames before estimating the flow, or the flow after [default: the protocol's]
    #[arg(long, value_name = "ORDER")]
    pub resize: Option<ResizeOrder>,
    /// The head's motion in the flow: keep or subtract [default: the protocol's]
    #[arg(long, value_name = "WHAT")]
    pub head_motion: Option<HeadMotion>,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
}

impl PreparationArgs {
    /// How faces become features where `protocol` is the one that settings leave open.
    pub(super) fn features(&self, protocol: RecognitionProtocol) -> FeatureSettings {
        let FeatureSettings { resize, head_motion, .. } = protocol.features();
        FeatureSettings {
            resize: self.resize.unwrap_or(resize),
            head_motion: self.head_motion.unwrap_or(head_motion),
            strain: self.strain,
        }
    }

    /// The settings except for the apex. Detected landmarks are written to `file`.
    ///
    /// # Errors
    /// When the landmarks cannot be read, detected or written.
    pub(super) fn preparation(
        &self,
        protocol: RecognitionProtocol,
        datasets: &[ClipDataset],
        file: impl FnOnce() -> PathBuf,
        force: bool,
        watch: &Watch,
    ) -> anyhow::Result<Preparation> {
        let clips = datasets.iter().flat_map(|dataset| &dataset.clips);
        let face = self.face.of_clips(clips, file, force, watch)?;
        Ok(Preparation { face, features: self.features(protocol) })
    }
}
