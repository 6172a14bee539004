//! Arguments for turning frames into features.

use std::path::PathBuf;

use clap::Args;
use srflow_mer::{ApexRule, Preparation, ResizeOrder, StrainFormula};
use srflow_read::micro_expression::ClipDataset;

use crate::face::FaceArgs;

/// From frames to features.
#[derive(Args, Debug, Clone)]
pub struct PreparationArgs {
    /// How to spot the apex of clips without one: ratio or strain
    #[arg(long, value_name = "RULE")]
    pub apex: Option<ApexRule>,
    /// Formula of the optical strain: literature or off-tanet
    #[arg(long, value_name = "FORMULA", default_value_t = StrainFormula::Literature)]
    strain: StrainFormula,
    /// Resize the frames to 112x112 before the flow is estimated, or the flow after
    #[arg(long, value_name = "ORDER", default_value_t = ResizeOrder::Before)]
    resize: ResizeOrder,
    #[command(flatten)]
    face: FaceArgs,
}

impl PreparationArgs {
    /// The settings that the arguments describe, except for the apex. Landmarks that are found are written to `file`.
    ///
    /// # Errors
    /// When the landmarks cannot be read, found or written.
    pub fn preparation(
        &self,
        datasets: &[ClipDataset],
        file: impl FnOnce() -> PathBuf,
        force: bool,
    ) -> anyhow::Result<Preparation> {
        let face = self.face.of_clips(
            datasets.iter().flat_map(|dataset| &dataset.clips),
            file,
            force,
            &crate::run::WATCH,
        )?;
        Ok(Preparation { face, resize: self.resize, strain: self.strain })
    }
}
