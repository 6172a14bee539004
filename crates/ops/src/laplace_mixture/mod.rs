//! How unlikely a difference is under a mixture of two Laplace distributions: the loss of SEA-RAFT (Wang, Lipson and Deng, ECCV 2024,
//! section 3.2). [`mod@reference`] is the definition.

use rayon::prelude::*;
use srflow_simd::SharedMut;

mod composed;
pub mod reference;
pub mod tensor;

/// Distributions of a mixture: the wide one and the narrow one.
const PARTS: usize = 2;
/// Components of a difference.
const COMPONENTS: usize = 2;
/// Pixels of a task.
const CHUNK: usize = 4096;

/// The allowed logarithms of the scales.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogScaleRange {
    /// Those of the narrow distribution are at least this, and at most 0.
    pub low: f32,
    /// Those of the wide distribution are at most this, and at least 0.
    pub high: f32,
}

/// A mixture at a pixel.
struct Mixture {
    log_weights: [f32; PARTS],
    /// Within their ranges.
    log_scales: [f32; PARTS],
    /// `exp(-log_scale)`.
    steepness: [f32; PARTS],
    /// Whether a scale was within its range.
    free: [bool; PARTS],
}

impl Mixture {
    fn new(log_weights: [f32; PARTS], log_scales: [f32; PARTS], range: LogScaleRange) -> Self {
        let limits = [(0.0, range.high), (range.low, 0.0)];
        let limited: [f32; PARTS] = std::array::from_fn(|k| log_scales[k].clamp(limits[k].0, limits[k].1));
        Self {
            log_weights,
            log_scales: limited,
            steepness: limited.map(|scale| (-scale).exp()),
            free: std::array::from_fn(|k| log_scales[k] >= limits[k].0 && log_scales[k] <= limits[k].1),
        }
    }

    /// Logarithms of the densities at a difference, each with its weight.
    fn log_densities(&self, difference: f32) -> [f32; PARTS] {
        std::array::from_fn(|k| {
            let log_peak = self.log_weights[k] - self.log_scales[k] - std::f32::consts::LN_2;
            log_peak - difference.abs() * self.steepness[k]
        })
    }
}

/// `ln(e^a + e^b)` without overflow.
fn log_sum_exp([a, b]: [f32; PARTS]) -> f32 {
    a.max(b) + (-(a - b).abs()).exp().ln_1p()
}

/// `e^x` over their sum.
fn softmax(x: [f32; PARTS]) -> [f32; PARTS] {
    let sum = log_sum_exp(x);
    x.map(|x| (x - sum).exp())
}

/// The number of images, of so many pixels each. Panics when the lengths do not fit.
fn check(difference: &[f32], log_weights: &[f32], log_scales: &[f32], pixels: usize) -> usize {
    let numbers = COMPONENTS * pixels;
    let batch = difference.len() / numbers.max(1);
    assert_eq!(difference.len(), batch * numbers, "two components for {pixels} pixels");
    assert_eq!(log_weights.len(), difference.len(), "two weights for each pixel");
    assert_eq!(log_scales.len(), difference.len(), "two scales for each pixel");
    batch
}

/// Calls `piece(offset of the image's numbers, pixels)` for pieces of all images, on all threads.
fn for_pieces(batch: usize, pixels: usize, piece: impl Fn(usize, std::ops::Range<usize>) + Sync) {
    let pieces = pixels.div_ceil(CHUNK);
    (0..batch * pieces).into_par_iter().for_each(|number| {
        let first = number % pieces * CHUNK;
        piece(number / pieces * COMPONENTS * pixels, first..(first + CHUNK).min(pixels));
    });
}

/// `-ln p(difference)` for each component of `difference` (`[batch, 2, pixels]`), where `p(d) = sum_k w_k / (2 b_k) exp(-|d| / b_k)`.
/// Both components share `ln w` up to a constant, `log_weights`, and `ln b`, `log_scales`, which are clamped to their ranges (both
/// `[batch, 2, pixels]`: wide, then narrow). Panics when the lengths do not fit.
pub fn negative_log_likelihood(
    difference: &[f32],
    log_weights: &[f32],
    log_scales: &[f32],
    pixels: usize,
    range: LogScaleRange,
) -> Vec<f32> {
    let batch = check(difference, log_weights, log_scales, pixels);
    let mut out = vec![0.0; difference.len()];
    let target = SharedMut::new(&mut out);
    for_pieces(batch, pixels, |image, piece| {
        for pixel in piece {
            let at = [image + pixel, image + pixels + pixel];
            let mixture = Mixture::new(at.map(|at| log_weights[at]), at.map(|at| log_scales[at]), range);
            let of_weights = log_sum_exp(mixture.log_weights);
            for at in at {
                let found = of_weights - log_sum_exp(mixture.log_densities(difference[at]));
                // SAFETY: this pixel of this image belongs to this task.
                unsafe { *target.at(at) = found }
            }
        }
    });
    out
}

/// Gradients of difference, log weights and log scales, given `grad`, that of the output. Panics when the lengths do not fit.
pub fn negative_log_likelihood_backward(
    difference: &[f32],
    log_weights: &[f32],
    log_scales: &[f32],
    grad: &[f32],
    pixels: usize,
    range: LogScaleRange,
) -> [Vec<f32>; 3] {
    let batch = check(difference, log_weights, log_scales, pixels);
    assert_eq!(grad.len(), difference.len(), "a gradient for each component");
    let mut found = [(); 3].map(|()| vec![0.0; difference.len()]);
    let [d_difference, d_weights, d_scales] = &mut found;
    let targets = [d_difference, d_weights, d_scales].map(|values| SharedMut::new(values));
    for_pieces(batch, pixels, |image, piece| {
        for pixel in piece {
            let at = [image + pixel, image + pixels + pixel];
            let mixture = Mixture::new(at.map(|at| log_weights[at]), at.map(|at| log_scales[at]), range);
            let shares = softmax(mixture.log_weights);
            let (mut of_weights, mut of_scales) = ([0.0; PARTS], [0.0; PARTS]);
            for at in at {
                let (difference, grad) = (difference[at], grad[at]);
                let likely = softmax(mixture.log_densities(difference));
                let mut slope = 0.0;
                for k in 0..PARTS {
                    of_weights[k] += grad * (shares[k] - likely[k]);
                    if mixture.free[k] {
                        of_scales[k] += grad * likely[k] * (1.0 - difference.abs() * mixture.steepness[k]);
                    }
                    slope += likely[k] * mixture.steepness[k];
                }
                let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
                // SAFETY: this pixel of this image belongs to this task.
                unsafe { *targets[0].at(at) = grad * slope * sign }
            }
            for k in 0..PARTS {
                // SAFETY: as above.
                unsafe {
                    *targets[1].at(at[k]) = of_weights[k];
                    *targets[2].at(at[k]) = of_scales[k];
                }
            }
        }
    });
    found
}

#[cfg(test)]
pub(crate) mod tests;
