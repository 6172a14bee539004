//! How unlikely a difference is under a mixture of two Laplace distributions: the loss of SEA-RAFT (Wang, Lipson and Deng, ECCV 2024,
//! section 3.2). [`mod@reference`] is the definition.

use rayon::prelude::*;
use srflow_simd::{Isa, Simd, dispatch, exp, ln_1p};

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

/// What the likelihood depends on, or a piece of it: each channel's pixels.
#[derive(Clone, Copy)]
struct Given<'a> {
    difference: [&'a [f32]; COMPONENTS],
    log_weights: [&'a [f32]; PARTS],
    log_scales: [&'a [f32]; PARTS],
    range: LogScaleRange,
}

impl<'a> Given<'a> {
    fn of_image(
        [difference, log_weights, log_scales]: [&'a [f32]; 3],
        image: usize,
        pixels: usize,
        range: LogScaleRange,
    ) -> Self {
        let [difference, log_weights, log_scales] =
            [difference, log_weights, log_scales].map(|x| channels(x, image, pixels));
        Self { difference, log_weights, log_scales, range }
    }

    fn piece(self, number: usize, length: usize) -> Self {
        let [difference, log_weights, log_scales] =
            [self.difference, self.log_weights, self.log_scales].map(|x| piece(x, number, length));
        Self { difference, log_weights, log_scales, range: self.range }
    }
}

/// The channels of an image.
fn channels(x: &[f32], image: usize, pixels: usize) -> [&[f32]; 2] {
    x[image * COMPONENTS * pixels..][..COMPONENTS * pixels].split_at(pixels).into()
}

/// Piece `number` of the channels of an image, which has this length.
fn piece(channels: [&[f32]; 2], number: usize, length: usize) -> [&[f32]; 2] {
    channels.map(|x| &x[number * CHUNK..][..length])
}

/// Mixtures at as many pixels as a vector holds.
struct Mixture<S: Simd> {
    log_weights: [S::Vector; PARTS],
    /// `ln(w / 2 b)`, where the scale `b` is within its range.
    log_peaks: [S::Vector; PARTS],
    /// `1 / b`.
    steepness: [S::Vector; PARTS],
    /// Whether a scale was within its range.
    free: [S::Mask; PARTS],
}

impl<S: Simd> Mixture<S> {
    /// From pixel `at` on.
    #[inline(always)]
    fn at(s: S, given: &Given, at: usize) -> Self {
        let LogScaleRange { low, high } = given.range;
        let [wide, narrow] = given.log_scales.map(|scales| s.read_first(&scales[at..]));
        let limited = |x, low, high| s.max(s.splat(low), s.min(s.splat(high), x));
        let (limited_wide, limited_narrow) = (limited(wide, 0.0, high), limited(narrow, low, 0.0));
        let free = |x, low, high| s.and(s.at_least(x, s.splat(low)), s.at_least(s.splat(high), x));
        let log_weights = given.log_weights.map(|weights| s.read_first(&weights[at..]));
        let log_peak = |weight, scale| s.sub(weight, s.add(scale, s.splat(std::f32::consts::LN_2)));
        Self {
            log_weights,
            log_peaks: [log_peak(log_weights[0], limited_wide), log_peak(log_weights[1], limited_narrow)],
            // `exp` takes no positive number.
            steepness: [
                exp(s, s.sub(s.splat(0.0), limited_wide)),
                s.div(s.splat(1.0), exp(s, limited_narrow)),
            ],
            free: [free(wide, 0.0, high), free(narrow, low, 0.0)],
        }
    }

    /// Logarithms of the densities at a difference of this length, each with its weight.
    #[inline(always)]
    fn log_densities(&self, s: S, distance: S::Vector) -> [S::Vector; PARTS] {
        std::array::from_fn(|k| s.neg_mul_add(distance, self.steepness[k], self.log_peaks[k]))
    }
}

/// `-|a - b|`.
#[inline(always)]
fn apart<S: Simd>(s: S, [a, b]: [S::Vector; PARTS]) -> S::Vector {
    s.negative(s.sub(a, b))
}

/// `ln(e^a + e^b)` without overflow.
#[inline(always)]
fn log_sum_exp<S: Simd>(s: S, [a, b]: [S::Vector; PARTS]) -> S::Vector {
    s.add(s.max(a, b), ln_1p(s, exp(s, apart(s, [a, b]))))
}

/// `e^a` and `e^b` over their sum.
#[inline(always)]
fn softmax<S: Simd>(s: S, [a, b]: [S::Vector; PARTS]) -> [S::Vector; PARTS] {
    let less = exp(s, apart(s, [a, b]));
    let larger = s.div(s.splat(1.0), s.add(s.splat(1.0), less));
    let smaller = s.mul(less, larger);
    let first_is_larger = s.at_least(a, b);
    [s.select(first_is_larger, larger, smaller), s.select(first_is_larger, smaller, larger)]
}

#[inline(always)]
fn absolute<S: Simd>(s: S, x: S::Vector) -> S::Vector {
    s.sub(s.splat(0.0), s.negative(x))
}

dispatch! {
    /// `out`: for each component.
    fn likelihood = likelihood_kernel(given: &Given, out: [&mut [f32]; COMPONENTS])
}

#[inline(always)]
fn likelihood_kernel<S: Simd>(s: S, given: &Given, out: [&mut [f32]; COMPONENTS]) {
    for at in (0..out[0].len()).step_by(S::LANES) {
        let mixture = Mixture::at(s, given, at);
        let of_weights = log_sum_exp(s, mixture.log_weights);
        for component in 0..COMPONENTS {
            let distance = absolute(s, s.read_first(&given.difference[component][at..]));
            let found = s.sub(of_weights, log_sum_exp(s, mixture.log_densities(s, distance)));
            s.write_first(found, &mut out[component][at..]);
        }
    }
}

dispatch! {
    /// Gradients of difference, log weights and log scales.
    fn slopes = slopes_kernel(given: &Given, grad: [&[f32]; COMPONENTS], out: [[&mut [f32]; 2]; 3])
}

#[inline(always)]
fn slopes_kernel<S: Simd>(s: S, given: &Given, grad: [&[f32]; COMPONENTS], out: [[&mut [f32]; 2]; 3]) {
    let [of_difference, of_weights, of_scales] = out;
    let (zero, one) = (s.splat(0.0), s.splat(1.0));
    for at in (0..of_difference[0].len()).step_by(S::LANES) {
        let mixture = Mixture::at(s, given, at);
        let shares = softmax(s, mixture.log_weights);
        let (mut weights, mut scales) = ([zero; PARTS], [zero; PARTS]);
        for component in 0..COMPONENTS {
            let difference = s.read_first(&given.difference[component][at..]);
            let grad = s.read_first(&grad[component][at..]);
            let distance = absolute(s, difference);
            let likely = softmax(s, mixture.log_densities(s, distance));
            let mut slope = zero;
            for k in 0..PARTS {
                weights[k] = s.mul_add(grad, s.sub(shares[k], likely[k]), weights[k]);
                let one_less = s.neg_mul_add(distance, mixture.steepness[k], one);
                let of_scale = s.mul_add(s.mul(grad, likely[k]), one_less, scales[k]);
                scales[k] = s.select(mixture.free[k], of_scale, zero);
                slope = s.mul_add(likely[k], mixture.steepness[k], slope);
            }
            let sign = s.select(s.greater(zero, difference), s.splat(-1.0), zero);
            let sign = s.select(s.greater(difference, zero), one, sign);
            s.write_first(s.mul(s.mul(grad, slope), sign), &mut of_difference[component][at..]);
        }
        for k in 0..PARTS {
            s.write_first(weights[k], &mut of_weights[k][at..]);
            s.write_first(scales[k], &mut of_scales[k][at..]);
        }
    }
}

/// Checks that the lengths fit; panics when they do not.
fn check([difference, log_weights, log_scales]: [&[f32]; 3], pixels: usize) {
    assert_eq!(difference.len() % (COMPONENTS * pixels).max(1), 0, "two components for {pixels} pixels");
    assert_eq!(log_weights.len(), difference.len(), "two weights for each pixel");
    assert_eq!(log_scales.len(), difference.len(), "two scales for each pixel");
}

/// The channels of each image.
fn images(x: &mut [f32], pixels: usize) -> impl Iterator<Item = [&mut [f32]; 2]> {
    x.chunks_exact_mut((COMPONENTS * pixels).max(1)).map(move |image| image.split_at_mut(pixels).into())
}

/// Pieces of the channels of an image.
fn pieces([first, second]: [&mut [f32]; 2]) -> impl IndexedParallelIterator<Item = [&mut [f32]; 2]> {
    first.par_chunks_mut(CHUNK).zip(second.par_chunks_mut(CHUNK)).map(Into::into)
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
    let (isa, given) = (Isa::best(), [difference, log_weights, log_scales]);
    check(given, pixels);
    let mut out = vec![0.0; difference.len()];
    for (image, out) in images(&mut out, pixels).enumerate() {
        let given = Given::of_image(given, image, pixels, range);
        pieces(out).enumerate().for_each(|(number, out)| {
            likelihood(isa, &given.piece(number, out[0].len()), out);
        });
    }
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
    let (isa, given) = (Isa::best(), [difference, log_weights, log_scales]);
    check(given, pixels);
    assert_eq!(grad.len(), difference.len(), "a gradient for each component");
    let mut found = [(); 3].map(|()| vec![0.0; difference.len()]);
    let [of_difference, of_weights, of_scales] = found.each_mut().map(|x| images(x, pixels));
    for (image, ((of_difference, of_weights), of_scales)) in
        of_difference.zip(of_weights).zip(of_scales).enumerate()
    {
        let given = Given::of_image(given, image, pixels, range);
        let grad = channels(grad, image, pixels);
        pieces(of_difference).zip(pieces(of_weights)).zip(pieces(of_scales)).enumerate().for_each(
            |(number, ((of_difference, of_weights), of_scales))| {
                let length = of_difference[0].len();
                let out = [of_difference, of_weights, of_scales];
                slopes(isa, &given.piece(number, length), piece(grad, number, length), out);
            },
        );
    }
    found
}

#[cfg(test)]
pub(crate) mod tests;
