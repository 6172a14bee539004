use serde::{Deserialize, Serialize};

use srflow_data::flow::TruthDensity;

use super::error::AugmentError;

/// Random changes to a training sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Dense: scaling interpolates the flow, and a pixel with an unknown source is unknown. Sparse: scaling moves each known
    /// pixel to the nearest new one.
    pub truth: TruthDensity,
    /// Width and height of the result, in pixels.
    pub crop: [usize; 2],
    /// Limits of the base-2 logarithm of the scale.
    pub log2_scale: [f32; 2],
    /// Probability that a sample is scaled.
    pub scale_probability: f32,
    /// Probability that a scaled sample is also stretched, by another factor along each axis.
    pub stretch_probability: f32,
    /// Limit of the base-2 logarithm of a stretch, in either direction.
    pub max_log2_stretch: f32,
    /// Probability of a horizontal flip.
    pub horizontal_flip: f32,
    /// Probability of a vertical flip.
    pub vertical_flip: f32,
    /// Probability that frame 2 becomes frame 1 with other noise, and the flow zero.
    pub still_probability: f32,
    /// Probability that frame 2 is cropped at another place than frame 1, which adds a constant to the whole flow.
    pub shift_probability: f32,
    /// Whether the background outside a mask shows that shift; if not, its flow becomes unknown.
    pub shift_background: bool,
    /// Maximum offset of that crop along each axis, in pixels after scaling.
    pub max_shift: u32,
    /// Strength of the brightness change: the factor lies in `1 - brightness .. 1 + brightness`.
    pub brightness: f32,
    /// Strength of the contrast change, likewise.
    pub contrast: f32,
    /// Strength of the saturation change, likewise.
    pub saturation: f32,
    /// Strength of the hue change, in turns of the colour circle, at most 0.5.
    pub hue: f32,
    /// Probability that the two frames change colour independently.
    pub asymmetric_probability: f32,
    /// Probability that one or two rectangles of frame 2 are erased, as if occluded.
    pub eraser_probability: f32,
    /// Minimum and maximum sides of a rectangle, in pixels of the frame before scaling.
    pub eraser_sides: [u32; 2],
}

impl Default for AugmentConfig {
    /// [`Self::dense`] for the paper's crop.
    fn default() -> Self {
        Self::dense([512, 800])
    }
}

impl AugmentConfig {
    /// SKFlow's augmentation for dense ground truth (core/utils/augmentor.py, `FlowAugmentor`), for a crop of this width and height.
    pub fn dense(crop: [usize; 2]) -> Self {
        Self {
            truth: TruthDensity::Dense,
            crop,
            log2_scale: [-0.2, 0.5],
            scale_probability: 0.8,
            stretch_probability: 0.8,
            max_log2_stretch: 0.2,
            horizontal_flip: 0.5,
            vertical_flip: 0.1,
            still_probability: 0.0,
            shift_probability: 0.0,
            shift_background: false,
            max_shift: 16,
            brightness: 0.4,
            contrast: 0.4,
            saturation: 0.4,
            hue: 0.159_235_67, // 0.5 / 3.14
            asymmetric_probability: 0.2,
            eraser_probability: 0.5,
            eraser_sides: [50, 99],
        }
    }

    /// SKFlow's augmentation for sparse ground truth (`SparseFlowAugmentor`), for a crop of this width and height. It never
    /// stretches, never flips vertically, and changes the colours of both frames alike. SKFlow does not flip KITTI
    /// ([`horizontal_flip`](Self::horizontal_flip) 0), but flips HD1K.
    pub fn sparse(crop: [usize; 2]) -> Self {
        Self {
            truth: TruthDensity::Sparse,
            stretch_probability: 0.0,
            vertical_flip: 0.0,
            brightness: 0.3,
            contrast: 0.3,
            saturation: 0.3,
            hue: 0.095_541_4, // 0.3 / 3.14
            asymmetric_probability: 0.0,
            ..Self::dense(crop)
        }
    }

    /// A random crop and nothing else.
    pub fn crop_only(crop: [usize; 2]) -> Self {
        Self {
            scale_probability: 0.0,
            horizontal_flip: 0.0,
            vertical_flip: 0.0,
            brightness: 0.0,
            contrast: 0.0,
            saturation: 0.0,
            hue: 0.0,
            eraser_probability: 0.0,
            ..Self::dense(crop)
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// Names the first number out of range, and its range.
    pub(super) fn check(&self) -> Result<(), AugmentError> {
        let require = |key, found: String, expected, fine| match fine {
            true => Ok(()),
            false => Err(AugmentError::Setting { key, found, expected }),
        };
        let number = |key, value: f32, most: f32, expected| {
            require(key, value.to_string(), expected, (0.0..=most).contains(&value))
        };
        let [width, height] = self.crop;
        let expected = "[WIDTH, HEIGHT], each from 1 to 65536 pixels";
        let fine = self.crop.iter().all(|side| (1..=1 << 16).contains(side));
        require("crop", format!("[{width}, {height}]"), expected, fine)?;
        let [low, high] = self.log2_scale;
        let fine = -8.0 <= low && low <= high && high <= 8.0;
        let expected = "[LOW, HIGH] with -8 <= LOW <= HIGH <= 8";
        require("log2_scale", format!("[{low}, {high}]"), expected, fine)?;
        number("max_log2_stretch", self.max_log2_stretch, 8.0, "a number from 0 to 8")?;
        for (key, value) in [
            ("scale_probability", self.scale_probability),
            ("stretch_probability", self.stretch_probability),
            ("horizontal_flip", self.horizontal_flip),
            ("vertical_flip", self.vertical_flip),
            ("still_probability", self.still_probability),
            ("shift_probability", self.shift_probability),
            ("asymmetric_probability", self.asymmetric_probability),
            ("eraser_probability", self.eraser_probability),
        ] {
            number(key, value, 1.0, "a probability from 0 to 1")?;
        }
        let shift = self.max_shift;
        require("max_shift", shift.to_string(), "at most 65536 pixels", shift <= 1 << 16)?;
        for (key, value) in
            [("brightness", self.brightness), ("contrast", self.contrast), ("saturation", self.saturation)]
        {
            number(key, value, 100.0, "a number from 0 to 100")?;
        }
        number("hue", self.hue, 0.5, "a part of the colour circle from 0 to 0.5")?;
        let [shortest, longest] = self.eraser_sides;
        let fine = 1 <= shortest && shortest <= longest && longest <= 1 << 16;
        let expected = "[SHORTEST, LONGEST] with 1 <= SHORTEST <= LONGEST <= 65536 pixels";
        require("eraser_sides", format!("[{shortest}, {longest}]"), expected, fine)
    }
}
