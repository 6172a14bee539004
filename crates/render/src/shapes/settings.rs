//! The settings of a dataset of generic pairs.

use std::path::PathBuf;

use srflow_files::FlowFormat;

use crate::RenderError;
use crate::error::check_size;

/// Maximum number of pairs: file names have five digits.
pub(super) const MAX_PAIRS: u32 = 99_999;

/// Minimum and maximum side of a frame, in pixels.
const SIDES: std::ops::RangeInclusive<usize> = 16..=4096;

/// Shortest and longest motion that can be asked for, in pixels.
const LENGTHS: std::ops::RangeInclusive<f32> = 0.001..=1000.0;

/// One pair in so many is for validation, as in FlyingChairs (640 of 22,872).
const PAIRS_PER_VALIDATION: u32 = 36;

/// The settings of a dataset of generic pairs.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapesSettings {
    pub pairs: u32,
    /// Frame width in pixels.
    pub width: usize,
    /// Frame height in pixels.
    pub height: usize,
    pub seed: u64,
    /// Typical length of the motions of a pair in pixels, from the shortest to the longest; each octave is equally likely.
    pub motion: [f32; 2],
    /// A folder of images, which half of the layers show.
    pub textures: Option<PathBuf>,
    pub flow_format: FlowFormat,
}

impl Default for ShapesSettings {
    /// As many pairs of the same size as FlyingChairs has, with motions from a quarter of a pixel.
    fn default() -> Self {
        Self {
            pairs: 22_872,
            width: 512,
            height: 384,
            seed: 1,
            motion: [0.25, 32.0],
            textures: None,
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
        let wrong = |argument, found: String, expected: String| {
            Err(RenderError::Argument { argument, found, expected })
        };
        if !(1..=MAX_PAIRS).contains(&self.pairs) {
            return wrong("--pairs", self.pairs.to_string(), format!("1 to {MAX_PAIRS}"));
        }
        check_size((self.width, self.height), SIDES)?;
        let [shortest, longest] = self.motion;
        if !(LENGTHS.contains(&shortest) && LENGTHS.contains(&longest) && shortest <= longest) {
            let (low, high) = (LENGTHS.start(), LENGTHS.end());
            let expected = format!("two lengths from {low} to {high} px, the shorter first, such as 0.25,32");
            return wrong("--motion", format!("{shortest},{longest}"), expected);
        }
        Ok(())
    }
}
