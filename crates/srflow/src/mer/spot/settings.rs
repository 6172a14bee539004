//! How expressions in long videos are spotted.

use serde::{Deserialize, Serialize};
use srflow_mer::HeadMotion;
use srflow_mer::spotting::SpottingSettings;

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::face::FaceArgs;
use crate::methods::{MethodParameters, MethodSpec};

/// How expressions in long videos are spotted.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SpottingArgs {
    /// Frames per second [default: the video's]
    #[arg(long, value_name = "RATE")]
    pub fps: Option<f64>,
    /// How to estimate the flow
    #[arg(long, value_name = "METHOD", default_value_t = SpottingArgs::default().method, help = crate::methods::Method::help())]
    pub method: MethodSpec,
    /// The head's motion in the flow: keep or subtract
    #[arg(long, value_name = "WHAT", default_value_t)]
    pub head_motion: HeadMotion,
    /// Spot micro-expressions that stand out from noise and surroundings by this factor
    #[arg(long, value_name = "FACTOR", default_value_t = SpottingSettings::default().micro_score)]
    pub micro_score: f64,
    /// Spot macro-expressions that stand out from noise by this factor
    #[arg(long, value_name = "FACTOR", default_value_t = SpottingSettings::default().macro_score)]
    pub macro_score: f64,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

impl Default for SpottingArgs {
    fn default() -> Self {
        let SpottingSettings { micro_score, macro_score } = SpottingSettings::default();
        Self {
            fps: None,
            // The fastest one: a video has many frames, and their motion is averaged over regions.
            method: "farneback".parse().expect("the name of a method"),
            head_motion: HeadMotion::default(),
            micro_score,
            macro_score,
            face: FaceArgs::default(),
            parameters: MethodParameters::default(),
        }
    }
}

impl SpottingArgs {
    /// # Errors
    /// When one of the limits is not a positive number.
    pub(super) fn limits(&self) -> anyhow::Result<SpottingSettings> {
        let Self { micro_score, macro_score, .. } = *self;
        for (name, value) in [("micro_score", micro_score), ("macro_score", macro_score)] {
            if !(value > 0.0 && value.is_finite()) {
                wrong_settings!("`{name}` must be a positive number");
            }
        }
        Ok(SpottingSettings { micro_score, macro_score })
    }
}
