//! The mapping from augmented pixels to those of the sample.

use srflow_core::Size;
use srflow_core::random::Key;
use srflow_data::flow::TruthDensity;

use super::config::AugmentConfig;

/// Scale, then mirror, then crop.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Geometry {
    /// Size before, `[width, height]`.
    pub(super) size: [usize; 2],
    /// Ratio of pixels after scaling to pixels before, `[x, y]`.
    pub(super) scale: [f64; 2],
    /// Size after scaling, `[width, height]`.
    pub(super) scaled: [usize; 2],
    /// Whether x and y are flipped, after scaling.
    pub(super) flip: [bool; 2],
    /// Top left pixel of the crop, `[x, y]`, after flipping.
    pub(super) corner: [usize; 2],
    /// Width and height of the crop.
    pub(super) crop: [usize; 2],
}

impl Geometry {
    pub(super) fn draw(config: &AugmentConfig, Size { width, height }: Size, key: Key) -> Self {
        let (size, crop) = ([width, height], config.crop);
        let scale = draw_scale(config, size, key);
        let flip = [config.horizontal_flip, config.vertical_flip];
        let mut stream = key.stream("augment: flip");
        let flip = flip.map(|probability| stream.unit() < probability);
        // The size that OpenCV's resize gives; rounding must not leave less than the crop.
        let scaled = [0, 1].map(|i| ((size[i] as f64 * scale[i]).round_ties_even() as usize).max(crop[i]));
        // Sparse truth is missing at the sides and at the top (KITTI), so crops favour both sides and the bottom.
        let margins = match config.truth {
            TruthDensity::Dense => [[0, 0], [0, 0]],
            TruthDensity::Sparse => [[50, 50], [0, 20]],
        };
        let mut stream = key.stream("augment: crop");
        let corner = [0, 1].map(|i| {
            let [before, after] = margins[i];
            let room = scaled[i] - crop[i];
            let places = u32::try_from(before + room + after + 1).unwrap_or(u32::MAX);
            let place = stream.below(places) as usize;
            place.saturating_sub(before).min(room)
        });
        Self { size, scale, scaled, flip, corner, crop }
    }

    /// The geometry of frame 2, which may be cropped at another place, and the constant that this adds to u and v.
    pub(super) fn shifted(&self, config: &AugmentConfig, key: Key) -> (Self, [f32; 2]) {
        let mut stream = key.stream("augment: shift");
        if stream.unit() >= config.shift_probability {
            return (self.clone(), [0.0; 2]);
        }
        let corner = [0, 1].map(|i| {
            let room = self.scaled[i] - self.crop[i];
            let most = config.max_shift as usize;
            let place = self.corner[i] + stream.below(2 * config.max_shift + 1) as usize;
            place.saturating_sub(most).min(room)
        });
        let added = [0, 1].map(|i| self.corner[i] as f32 - corner[i] as f32);
        (Self { corner, ..self.clone() }, added)
    }
}

/// Ratio of pixels after scaling to pixels before, for x and y; 1 without scaling.
fn draw_scale(config: &AugmentConfig, size: [usize; 2], key: Key) -> [f64; 2] {
    let mut stream = key.stream("augment: scale");
    let [low, high] = config.log2_scale;
    let log2 = stream.uniform(low, high);
    let mut log2 = [log2; 2];
    if stream.unit() < config.stretch_probability {
        log2 = log2.map(|log2| log2 + stream.uniform(-config.max_log2_stretch, config.max_log2_stretch));
    }
    let fits = size[0] >= config.crop[0] && size[1] >= config.crop[1];
    if fits && stream.unit() >= config.scale_probability {
        return [1.0; 2];
    }
    let spare = match config.truth {
        TruthDensity::Dense => 8,
        TruthDensity::Sparse => 1,
    };
    let smallest = |i: usize| (config.crop[i] + spare) as f64 / size[i] as f64;
    log2.map(|log2| libm::exp2(f64::from(log2)).max(smallest(0)).max(smallest(1)))
}
