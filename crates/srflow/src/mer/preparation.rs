//! How frames become features.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::ClipDataset;
use srflow_mer::{ApexRule, Preparation, ResizeOrder, StrainFormula};

use crate::Watch;
use crate::clap::Args;
use crate::face::FaceArgs;

/// How frames become features.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PreparationArgs {
    /// How to spot the apex of clips without one: ratio or strain
    #[arg(long, value_name = "RULE")]
    pub apex: Option<ApexRule>,
    /// Formula of the optical strain: literature or off-tanet
    #[arg(long, value_name = "FORMULA", default_value_t)]
    pub strain: StrainFormula,
    /// Resize to 112x112: the frames before estimating the flow, or the flow after
    #[arg(long, value_name = "ORDER", default_value_t)]
    pub resize: ResizeOrder,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
}

impl PreparationArgs {
    /// The settings except for the apex. Detected landmarks are written to `file`.
    ///
    /// # Errors
    /// When the landmarks cannot be read, detected or written.
    pub(super) fn preparation(
        &self,
        datasets: &[ClipDataset],
        file: impl FnOnce() -> PathBuf,
        force: bool,
        watch: &Watch,
    ) -> anyhow::Result<Preparation> {
        let clips = datasets.iter().flat_map(|dataset| &dataset.clips);
        let face = self.face.of_clips(clips, file, force, watch)?;
        Ok(Preparation { face, resize: self.resize, strain: self.strain })
    }
}
