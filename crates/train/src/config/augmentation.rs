use serde::{Deserialize, Serialize};
use srflow_field::Size;
use srflow_read::augment::AugmentConfig;
use srflow_read::flow::TruthDensity;

/// How samples are changed at random before they are used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentationConfig {
    /// Which of SKFlow's two augmentations.
    pub kind: AugmentationKind,
    /// Limits of the base-2 logarithm of the scale.
    pub log2_scale: [f32; 2],
    /// How often a sample is scaled at all.
    pub scale_probability: f32,
    /// How often a sample is mirrored left to right.
    pub horizontal_flip: f32,
    /// How often a sample with dense truth is mirrored top to bottom.
    pub vertical_flip: f32,
    /// How often frame 2 is cropped somewhere else than frame 1, which adds one motion to the whole flow; not SKFlow's.
    pub shift_probability: f32,
    /// How far at most, in pixels of the crop.
    pub max_shift: u32,
    /// How often one or two rectangles of frame 2 are painted over.
    pub eraser_probability: f32,
    /// Limits of a rectangle's sides, in pixels of the frame before it is scaled.
    pub eraser_sides: [u32; 2],
    /// How much colours change: 1 as in SKFlow, 0 not at all.
    pub color: f32,
}

/// Which of SKFlow's augmentations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AugmentationKind {
    /// Sparse for datasets whose truth is sparse (KITTI, HD1K), dense for all others.
    Auto,
    /// For flow that is known nearly everywhere.
    Dense,
    /// For flow that is known at some pixels.
    Sparse,
    /// A crop at a random place, and nothing else.
    None,
}

impl Default for AugmentationConfig {
    fn default() -> Self {
        let skflow = AugmentConfig::default();
        Self {
            kind: AugmentationKind::Auto,
            // SKFlow's range for Sintel, the set whose frames resemble SRFlow's most.
            log2_scale: [-0.2, 0.6],
            scale_probability: skflow.scale_probability,
            horizontal_flip: skflow.horizontal_flip,
            vertical_flip: skflow.vertical_flip,
            shift_probability: skflow.shift_probability,
            max_shift: skflow.max_shift,
            eraser_probability: skflow.eraser_probability,
            eraser_sides: skflow.eraser_sides,
            color: 1.0,
        }
    }
}

impl AugmentationConfig {
    /// What is done to samples whose truth is dense or sparse.
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
            shift_probability: self.shift_probability,
            max_shift: self.max_shift,
            eraser_probability: self.eraser_probability,
            eraser_sides: self.eraser_sides,
            brightness: skflow.brightness * self.color,
            contrast: skflow.contrast * self.color,
            saturation: skflow.saturation * self.color,
            hue: skflow.hue * self.color,
            ..skflow
        }
    }
}
