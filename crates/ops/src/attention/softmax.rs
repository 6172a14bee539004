//! Softmax weights from scores, its sums, and its gradient. A block holds one panel's numbers for neighbouring pixels, `[rows,
//! columns of the panel]`.

use srflow_simd::{Simd, dispatch, exp, multiversioned};

dispatch! {
    /// Raises `maxima` to the largest score of each column, and adds `exp(score - maximum)` to `sums`, which are rescaled when the
    /// maximum grows. A NaN score makes the sum of its column NaN.
    pub(super) fn add_to_sums = add_to_sums_kernel(scores: &[f32], maxima: &mut [f32], sums: &mut [f32])
}

#[inline(always)]
fn add_to_sums_kernel<S: Simd>(s: S, scores: &[f32], maxima: &mut [f32], sums: &mut [f32]) {
    let width = maxima.len();
    let rows = scores.len() / width;
    assert!(width.is_multiple_of(S::LANES) && sums.len() == width);
    for x in (0..width).step_by(S::LANES) {
        // SAFETY: `x` is at least a vector before the end of a row, and there are this many rows.
        let score = |row: usize| unsafe { s.load(scores.as_ptr().add(row * width + x)) };
        let before = s.read(&maxima[x..]);
        let mut largest = before;
        for row in 0..rows {
            largest = s.max(largest, score(row));
        }
        // Before the first block the sum is zero.
        let mut sum = s.mul(s.read(&sums[x..]), exp(s, s.sub(before, largest)));
        for row in 0..rows {
            sum = s.add(sum, exp(s, s.sub(score(row), largest)));
        }
        s.write(largest, &mut maxima[x..]);
        s.write(sum, &mut sums[x..]);
    }
}

dispatch! {
    /// Raises `maxima` to the largest score of each column, converts scores to `exp(score - maximum)` and adds them to `sums`.
    /// What was summed with smaller maxima is to be multiplied by `factors`, as the sums are.
    pub(super) fn exponentiate =
        exponentiate_kernel(scores: &mut [f32], maxima: &mut [f32], sums: &mut [f32], factors: &mut [f32])
}

#[inline(always)]
fn exponentiate_kernel<S: Simd>(
    s: S,
    scores: &mut [f32],
    maxima: &mut [f32],
    sums: &mut [f32],
    factors: &mut [f32],
) {
    let width = maxima.len();
    let rows = scores.len() / width;
    assert!(width.is_multiple_of(S::LANES) && sums.len() == width && factors.len() == width);
    let start = scores.as_mut_ptr();
    for x in (0..width).step_by(S::LANES) {
        let before = s.read(&maxima[x..]);
        let mut largest = before;
        for row in 0..rows {
            // SAFETY: `x` is at least a vector before the end of a row, and there are this many rows.
            largest = s.max(largest, unsafe { s.load(start.add(row * width + x)) });
        }
        let factor = exp(s, s.sub(before, largest));
        let mut sum = s.mul(s.read(&sums[x..]), factor);
        for row in 0..rows {
            // SAFETY: as above.
            unsafe {
                let at = start.add(row * width + x);
                let weight = exp(s, s.sub(s.load(at), largest));
                s.store(at, weight);
                sum = s.add(sum, weight);
            }
        }
        s.write(largest, &mut maxima[x..]);
        s.write(sum, &mut sums[x..]);
        s.write(factor, &mut factors[x..]);
    }
}

multiversioned! {
    /// Multiplies each column of `rows`, which are as wide as there are factors.
    pub(super) fn scale_columns(rows: &mut [f32], factors: &[f32]) {
        for row in rows.chunks_exact_mut(factors.len()) {
            row.iter_mut().zip(factors).for_each(|(x, factor)| *x *= factor);
        }
    }
}

/// The largest score of each query, and the inverse of the sum of its `exp(score - maximum)`.
#[derive(Debug, Clone, Copy)]
pub(super) enum Normal<'a> {
    /// Of each column of the panel.
    OfColumns { maxima: &'a [f32], inverse_sums: &'a [f32] },
    /// Of each row of the block.
    OfRows { maxima: &'a [f32], inverse_sums: &'a [f32] },
}

dispatch! {
    /// Converts scores to weights, `exp(score - maximum) * inverse_sum`; `width` is that of the panel.
    pub(super) fn weigh = weigh_kernel(scores: &mut [f32], width: usize, normal: Normal)
}

#[inline(always)]
fn weigh_kernel<S: Simd>(s: S, scores: &mut [f32], width: usize, normal: Normal) {
    let rows = scores.len() / width;
    assert!(width.is_multiple_of(S::LANES));
    match normal {
        Normal::OfColumns { maxima, inverse_sums } => {
            for x in (0..width).step_by(S::LANES) {
                let (maximum, inverse_sum) = (s.read(&maxima[x..]), s.read(&inverse_sums[x..]));
                for row in 0..rows {
                    weigh_vector(s, &mut scores[row * width + x..], maximum, inverse_sum);
                }
            }
        }
        Normal::OfRows { maxima, inverse_sums } => {
            for row in 0..rows {
                let (maximum, inverse_sum) = (s.splat(maxima[row]), s.splat(inverse_sums[row]));
                for x in (0..width).step_by(S::LANES) {
                    weigh_vector(s, &mut scores[row * width + x..], maximum, inverse_sum);
                }
            }
        }
    }
}

/// Not a closure, which is not always compiled for the instruction set of its caller.
#[inline(always)]
fn weigh_vector<S: Simd>(s: S, scores: &mut [f32], maximum: S::Vector, inverse_sum: S::Vector) {
    s.write(s.mul(exp(s, s.sub(s.read(scores), maximum)), inverse_sum), scores);
}

dispatch! {
    /// Converts gradients of weights to gradients of scores, `weight * (gradient - mean)`; `means` has each column's mean of
    /// the gradients, weighted by the weights. Weights and gradients have the same layout.
    pub(super) fn to_score_gradients = to_score_gradients_kernel(gradients: &mut [f32], weights: &[f32], means: &[f32])
}

#[inline(always)]
fn to_score_gradients_kernel<S: Simd>(s: S, gradients: &mut [f32], weights: &[f32], means: &[f32]) {
    let width = means.len();
    let rows = gradients.len() / width;
    assert!(width.is_multiple_of(S::LANES) && weights.len() >= rows * width);
    for x in (0..width).step_by(S::LANES) {
        let mean = s.read(&means[x..]);
        for row in 0..rows {
            // SAFETY: a whole vector of a row.
            unsafe {
                let at = gradients.as_mut_ptr().add(row * width + x);
                let weight = s.load(weights.as_ptr().add(row * width + x));
                s.store(at, s.mul(weight, s.sub(s.load(at), mean)));
            }
        }
    }
}
