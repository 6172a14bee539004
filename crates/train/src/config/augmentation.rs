use crate::augment::AugmentConfig;
use serde::{Deserialize, Serialize};
use srflow_core::Size;
use srflow_data::flow::TruthDensity;

/// Random augmentation of the training samples. Probabilities are in `0..=1`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentationConfig {
    pub kind: AugmentationKind,
    /// Range of the base-2 logarithm of the scale.
    pub log2_scale: [f32; 2],
    /// Probability of scaling a sample.
    pub scale_probability: f32,
    /// Probability of a horizontal flip.
    pub horizontal_flip: f32,
    /// Probability of a vertical flip, for samples with dense ground truth.
    pub vertical_flip: f32,
    /// Probability that nothing moves: frame 2 is frame 1 with other noise; not in SKFlow.
    pub still_probability: f32,
    /// Probability of cropping frame 2 at an offset from frame 1, which adds a constant to the flow; not in SKFlow.
    pub shift_probability: f32,
    /// Whether the background outside a mask shows the offset; false for plain ones, whose flow becomes unknown.
    pub shift_background: bool,
    /// Largest offset, in pixels of the crop.
    pub max_shift: u32,
    /// Probability of erasing one or two rectangles of frame 2.
    pub eraser_probability: f32,
    /// Range of the sides of a rectangle, in pixels of the unscaled frame.
    pub eraser_sides: [u32; 2],
    /// Strength of the colour jitter: 1 as in SKFlow, 0 for none.
    pub color: f32,
    /// Probability that both frames change colour independently, for samples with dense ground truth.
    pub asymmetric_color: f32,
}

/// SKFlow's dense or sparse augmentation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AugmentationKind {
    /// Sparse for datasets with sparse ground truth (KITTI, HD1K), dense for all others.
    Auto,
    /// For flow that is known nearly everywhere.
    Dense,
    /// For flow that is known at some pixels.
    Sparse,
    /// Only a random crop.
    None,
}

impl Default for AugmentationConfig {
    fn default() -> Self {
        let skflow = AugmentConfig::default();
        Self {
            kind: AugmentationKind::Auto,
            // SKFlow's range for Sintel, whose frames are the most similar to SRFlow's.
            log2_scale: [-0.2, 0.6],
            scale_probability: skflow.scale_probability,
            horizontal_flip: skflow.horizontal_flip,
            vertical_flip: skflow.vertical_flip,
            still_probability: skflow.still_probability,
            shift_probability: skflow.shift_probability,
            shift_background: skflow.shift_background,
            max_shift: skflow.max_shift,
            eraser_probability: skflow.eraser_probability,
            eraser_sides: skflow.eraser_sides,
            color: 1.0,
            asymmetric_color: skflow.asymmetric_probability,
        }
    }
}

impl AugmentationConfig {
    /// The augmentation of samples with this density of ground truth.
    pub(crate) fn settings(&self, truth: TruthDensity, crop: Size) -> AugmentConfig {
        let crop = [crop.width, crop.height];
        let sparse = match self.kind {
            AugmentationKind::None => return AugmentConfig::crop_only(crop),
            AugmentationKind::Auto => truth == TruthDensity::Sparse,
            AugmentationKind::Dense => false,
            AugmentationKind::Sparse => true,
        };
        let skflow = if sparse { AugmentConfig::sparse(crop) } else { AugmentConfig::dense(crop) };
        AugmentConfig {
            log2_scale: self.log2_scale,
            scale_probability: self.scale_probability,
            horizontal_flip: self.horizontal_flip,
            vertical_flip: if sparse { 0.0 } else { self.vertical_flip },
            still_probability: self.still_probability,
            shift_probability: self.shift_probability,
            shift_background: self.shift_background,
            max_shift: self.max_shift,
            eraser_probability: self.eraser_probability,
            eraser_sides: self.eraser_sides,
            brightness: skflow.brightness * self.color,
            contrast: skflow.contrast * self.color,
            saturation: skflow.saturation * self.color,
            hue: skflow.hue * self.color,
            asymmetric_probability: if sparse { 0.0 } else { self.asymmetric_color },
            ..skflow
        }
    }
}
