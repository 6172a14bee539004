use rayon::prelude::*;

use crate::{FlowField, Mask, SizeMismatch, check_same_size};

/// Ground truth with a component of this size or more is not scored: `max_flow` of ptlflow 0.4.2
/// (`ptlflow/data/datasets.py`, `_get_flows_and_valids`).
pub const MAX_SCORED_FLOW: f32 = 10_000.0;

/// Accuracy of a predicted flow over the valid pixels of one image, or averaged over images.
///
/// The definitions are those of ptlflow 0.4.2 (`ptlflow/utils/flow_metrics.py`), which the SRFlow paper uses.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Metrics {
    /// Mean end-point error in pixels.
    pub epe: f64,
    /// Fraction of pixels whose end-point error is under 1 pixel, `0..=1`.
    pub px1: f64,
    /// Fraction under 3 pixels.
    pub px3: f64,
    /// Fraction under 5 pixels.
    pub px5: f64,
    /// Percentage of outliers, `0..=100`: end-point error over 3 pixels and over 5% of the true flow's length.
    pub f1_all: f64,
    /// Weighted area under the curve, `0..=100` (Mehl et al., *Spring*, CVPR 2023): the percentages of pixels whose error
    /// is at most 0.05, 0.10, ... 5 pixels, averaged with weights 1, 0.99, ... 0.01.
    pub wauc: f64,
    /// Number of scored pixels.
    pub valid_pixels: u64,
}

/// Why a prediction could not be scored.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScoreError {
    /// Prediction, ground truth and mask differ in size.
    #[error(transparent)]
    Size(#[from] SizeMismatch),
    /// The prediction is unknown or infinite where the ground truth is known.
    #[error(
        "the prediction at pixel ({x}, {y}) is ({u}, {v}): expected finite numbers wherever the truth is known"
    )]
    NotFinite {
        x: usize,
        y: usize,
        /// Predicted flow, pixels.
        u: f32,
        /// Predicted flow, pixels.
        v: f32,
    },
}

/// Scores one prediction over the valid pixels: those with known true flow under [`MAX_SCORED_FLOW`] in both components, and
/// inside `mask` if there is one. `None` if there is no such pixel.
///
/// The result does not depend on the number of threads.
///
/// # Errors
/// When the sizes differ or the prediction is not finite at a valid pixel.
pub fn score(
    prediction: &FlowField,
    truth: &FlowField,
    mask: Option<&Mask>,
) -> Result<Option<Metrics>, ScoreError> {
    check_same_size("the prediction", prediction.size(), "the truth", truth.size())?;
    if let Some(mask) = mask {
        check_same_size("the mask", mask.size(), "the truth", truth.size())?;
    }
    // Blocks of a fixed size, added in order: the sum does not depend on the number of threads.
    const BLOCK: usize = 1 << 15;
    let inside = |index: usize| mask.is_none_or(|mask| mask.pixels()[index]);
    let blocks: Vec<Tally> = prediction
        .pixels()
        .par_chunks(BLOCK)
        .zip(truth.pixels().par_chunks(BLOCK))
        .enumerate()
        .map(|(block, (prediction, truth))| {
            let mut tally = Tally::default();
            for (offset, (prediction, truth)) in prediction.iter().zip(truth).enumerate() {
                if is_valid(*truth) && inside(block * BLOCK + offset) {
                    tally.add(*prediction, *truth);
                }
            }
            tally
        })
        .collect();
    let total = blocks.iter().fold(Tally::default(), Tally::plus);
    if !total.epe_sum.is_finite() {
        return Err(first_not_finite(prediction, truth, inside));
    }
    Ok(total.metrics())
}

fn is_valid([u, v]: [f32; 2]) -> bool {
    u.abs() < MAX_SCORED_FLOW && v.abs() < MAX_SCORED_FLOW // false for NaN
}

fn first_not_finite(prediction: &FlowField, truth: &FlowField, inside: impl Fn(usize) -> bool) -> ScoreError {
    let mut pixels = prediction.pixels().iter().zip(truth.pixels()).enumerate();
    let culprit = pixels.find(|(index, (prediction, truth))| {
        is_valid(**truth) && inside(*index) && !end_point_error(**prediction, **truth).is_finite()
    });
    // `valid` is not zero, and a sum of finite errors is finite in f64.
    let (index, [u, v]) = culprit.map_or((0, [f32::NAN; 2]), |(index, (prediction, _))| (index, *prediction));
    ScoreError::NotFinite { x: index % prediction.width(), y: index / prediction.width(), u, v }
}

/// The thresholds of WAUC.
const WAUC_STEPS: usize = 100;

/// Sums over pixels.
#[derive(Clone)]
struct Tally {
    pixels: u64,
    epe_sum: f64,
    under_1: u64,
    under_3: u64,
    under_5: u64,
    outliers: u64,
    /// At `i - 1`: number of pixels whose smallest reached threshold of WAUC is the `i`th; at the end, those beyond all.
    wauc_steps: [u64; WAUC_STEPS + 1],
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            pixels: 0,
            epe_sum: 0.0,
            under_1: 0,
            under_3: 0,
            under_5: 0,
            outliers: 0,
            wauc_steps: [0; WAUC_STEPS + 1],
        }
    }
}

impl Tally {
    /// Errors and comparisons are in `f32`, as in the reference, so that a pixel at a threshold falls on the same side.
    fn add(&mut self, prediction: [f32; 2], truth: [f32; 2]) {
        let epe = end_point_error(prediction, truth);
        self.pixels += 1;
        self.epe_sum += f64::from(epe);
        self.under_1 += u64::from(epe < 1.0);
        self.under_3 += u64::from(epe < 3.0);
        self.under_5 += u64::from(epe < 5.0);
        self.outliers += u64::from(epe > 3.0 && epe > 0.05 * length(truth));
        self.wauc_steps[wauc_step(epe)] += 1;
    }

    fn plus(mut self, other: &Self) -> Self {
        self.pixels += other.pixels;
        self.epe_sum += other.epe_sum;
        self.under_1 += other.under_1;
        self.under_3 += other.under_3;
        self.under_5 += other.under_5;
        self.outliers += other.outliers;
        for (sum, count) in self.wauc_steps.iter_mut().zip(other.wauc_steps) {
            *sum += count;
        }
        self
    }

    fn metrics(&self) -> Option<Metrics> {
        if self.pixels == 0 {
            return None;
        }
        let pixels = self.pixels as f64;
        // Weights are integer hundredths, so that a perfect prediction scores exactly 100.
        let (mut within, mut area, mut weights) = (0, 0, 0);
        for (step, count) in self.wauc_steps[..WAUC_STEPS].iter().enumerate() {
            let weight = (WAUC_STEPS - step) as u64;
            within += count;
            area += weight * within;
            weights += weight;
        }
        Some(Metrics {
            epe: self.epe_sum / pixels,
            px1: self.under_1 as f64 / pixels,
            px3: self.under_3 as f64 / pixels,
            px5: self.under_5 as f64 / pixels,
            f1_all: 100.0 * self.outliers as f64 / pixels,
            wauc: 100.0 * (area as f64 / (self.pixels * weights) as f64),
            valid_pixels: self.pixels,
        })
    }
}

fn end_point_error(prediction: [f32; 2], truth: [f32; 2]) -> f32 {
    length([prediction[0] - truth[0], prediction[1] - truth[1]])
}

fn length([u, v]: [f32; 2]) -> f32 {
    (u * u + v * v).sqrt()
}

/// Index of the smallest threshold (1/20, 2/20, ... 100/20 pixels) that is not below `epe`; [`WAUC_STEPS`] if none.
fn wauc_step(epe: f32) -> usize {
    let threshold = |step: usize| ((step + 1) as f64 / 20.0) as f32;
    let guess = (epe * 20.0) as usize; // NaN gives 0, infinity the largest
    // The product is rounded: the exact step is the guess or one of its neighbours.
    let first = guess.saturating_sub(1).min(WAUC_STEPS);
    (first..WAUC_STEPS).find(|step| epe <= threshold(*step)).unwrap_or(WAUC_STEPS)
}

/// The mean of [`Metrics`] over images, all with equal weight.
///
/// An image without valid pixels has no metrics: it does not enter the mean and is counted separately.
#[derive(Debug, Clone, Default)]
pub struct MeanMetrics {
    sums: [f64; 6],
    valid_pixels: u64,
    images: usize,
    images_without_valid_pixels: usize,
}

impl MeanMetrics {
    /// Adds the result of [`score`] for one image.
    pub fn add(&mut self, image: Option<&Metrics>) {
        let Some(image) = image else {
            self.images_without_valid_pixels += 1;
            return;
        };
        let values = [image.epe, image.px1, image.px3, image.px5, image.f1_all, image.wauc];
        for (sum, value) in self.sums.iter_mut().zip(values) {
            *sum += value;
        }
        self.valid_pixels += image.valid_pixels;
        self.images += 1;
    }

    /// The mean, with the sum of `valid_pixels`. `None` before the first image with a valid pixel.
    pub fn mean(&self) -> Option<Metrics> {
        if self.images == 0 {
            return None;
        }
        let [epe, px1, px3, px5, f1_all, wauc] = self.sums.map(|sum| sum / self.images as f64);
        Some(Metrics { epe, px1, px3, px5, f1_all, wauc, valid_pixels: self.valid_pixels })
    }

    /// Number of images in the mean.
    pub fn images(&self) -> usize {
        self.images
    }

    /// Number of images without valid pixels.
    pub fn images_without_valid_pixels(&self) -> usize {
        self.images_without_valid_pixels
    }
}
