//! The settings of a dataset of generic pairs.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_core::{Numbers, Size};
use srflow_files::FlowFormat;

use crate::RenderError;
use crate::clap::Args;
use crate::error::{check_size, require};

/// Maximum number of pairs: file names have five digits.
pub(super) const MAX_PAIRS: u32 = 99_999;

/// Minimum and maximum side of a frame, in pixels.
const SIDES: std::ops::RangeInclusive<usize> = 16..=4096;

/// Shortest and longest motion that can be asked for, in pixels.
const LENGTHS: std::ops::RangeInclusive<f32> = 0.001..=1000.0;

/// One pair in so many is for validation, as in FlyingChairs (640 of 22,872).
const PAIRS_PER_VALIDATION: u32 = 36;

/// The settings of a dataset of generic pairs.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ShapesSettings {
    /// Number of pairs
    #[arg(long, value_name = "N", default_value_t = Self::default().pairs)]
    pub pairs: u32,
    /// Size of the frames, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value_t = Self::default().size)]
    pub size: Size,
    /// Typical motion in pixels, from the shortest to the longest; each octave is equally likely
    #[arg(long, value_name = "SHORTEST,LONGEST", default_value_t = Self::default().motion)]
    pub motion: Numbers<f32, 2>,
    /// Folder of images for half of the layers [default: procedural textures]
    #[arg(long, value_name = "DIR")]
    pub textures: Option<PathBuf>,
    /// Random seed
    #[arg(long, value_name = "N", default_value_t = Self::default().seed)]
    pub seed: u64,
    /// File format of the flow
    #[arg(long, value_name = "FORMAT", default_value_t = Self::default().flow_format, help = crate::generate::flow_format_help())]
    pub flow_format: FlowFormat,
}

impl Default for ShapesSettings {
    /// As many pairs of the same size as FlyingChairs has, with motions from a quarter of a pixel.
    fn default() -> Self {
        Self {
            pairs: 22_872,
            size: Size::new(512, 384),
            motion: Numbers([0.25, 32.0]),
            textures: None,
            seed: 1,
            flow_format: FlowFormat::Npz16,
        }
    }
}

/// Whether a pair, counted from 0, is for validation.
pub(super) fn validates(pair: u32) -> bool {
    pair % PAIRS_PER_VALIDATION == PAIRS_PER_VALIDATION - 1
}

impl ShapesSettings {
    pub(super) fn validate(&self) -> Result<(), RenderError> {
        let pairs = (1..=MAX_PAIRS).contains(&self.pairs);
        require("pairs", self.pairs, format!("1 to {MAX_PAIRS}"), pairs)?;
        check_size(self.size, SIDES)?;
        let [shortest, longest] = *self.motion;
        let (low, high) = (LENGTHS.start(), LENGTHS.end());
        let expected = format!("two lengths from {low} to {high} px, the shorter first, such as 0.25,32");
        let fine = LENGTHS.contains(&shortest) && LENGTHS.contains(&longest) && shortest <= longest;
        require("motion", self.motion, expected, fine)
    }
}
