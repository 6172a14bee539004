//! What stands between scores and weights: the exponential, its sums, and the way back.

use srflow_simd::{Simd, dispatch, exp};

/// Numbers of one panel for neighbouring pixels, `[rows, columns of the panel]`.
#[derive(Clone, Copy)]
pub(super) struct Block {
    pub(super) scores: *mut f32,
    pub(super) rows: usize,
}

dispatch! {
    /// Raises `most` to the largest score of each column, and adds `exp(score - most)` to `sums`, which are scaled to that.
    ///
    /// # Safety
    /// the block can be read; both slices are as long as a panel is wide.
    pub(super) unsafe fn add_to_sums = add_to_sums_kernel(block: Block, most: &mut [f32], sums: &mut [f32])
}

#[inline(always)]
unsafe fn add_to_sums_kernel<S: Simd>(s: S, block: Block, most: &mut [f32], sums: &mut [f32]) {
    let width = most.len();
    for x in (0..width).step_by(S::LANES) {
        // SAFETY: the caller's promise.
        unsafe {
            let before = s.load(most[x..].as_ptr());
            let mut largest = before;
            for row in 0..block.rows {
                largest = s.max(largest, s.load(block.scores.add(row * width + x)));
            }
            // Before the first block the difference is infinite, and the sum zero.
            let mut sum = s.mul(s.load(sums[x..].as_ptr()), exp(s, s.sub(before, largest)));
            for row in 0..block.rows {
                sum = s.add(sum, exp(s, s.sub(s.load(block.scores.add(row * width + x)), largest)));
            }
            s.store(most[x..].as_mut_ptr(), largest);
            s.store(sums[x..].as_mut_ptr(), sum);
        }
    }
}

/// The largest score of each pixel that attends, and one over the sum of its `exp(score - most)`.
#[derive(Debug, Clone, Copy)]
pub(super) enum Normal<'a> {
    /// Of each column of the panel.
    OfColumns { most: &'a [f32], share: &'a [f32] },
    /// Of each row of the block.
    OfRows { most: &'a [f32], share: &'a [f32] },
}

dispatch! {
    /// Scores to weights, `exp(score - most) * share`.
    ///
    /// # Safety
    /// the block can be written; `width` is that of a panel, and `normal` as long as the panel is wide
    /// or the block has rows.
    pub(super) unsafe fn weigh = weigh_kernel(block: Block, width: usize, normal: Normal)
}

#[inline(always)]
unsafe fn weigh_kernel<S: Simd>(s: S, block: Block, width: usize, normal: Normal) {
    // SAFETY: the caller's promise.
    unsafe {
        match normal {
            Normal::OfColumns { most, share } => {
                for x in (0..width).step_by(S::LANES) {
                    let (most, share) = (s.load(most[x..].as_ptr()), s.load(share[x..].as_ptr()));
                    for row in 0..block.rows {
                        weigh_vector(s, block.scores.add(row * width + x), most, share);
                    }
                }
            }
            Normal::OfRows { most, share } => {
                for row in 0..block.rows {
                    let (most, share) = (s.splat(most[row]), s.splat(share[row]));
                    for x in (0..width).step_by(S::LANES) {
                        weigh_vector(s, block.scores.add(row * width + x), most, share);
                    }
                }
            }
        }
    }
}

#[inline(always)]
unsafe fn weigh_vector<S: Simd>(s: S, at: *mut f32, most: S::Vector, share: S::Vector) {
    // SAFETY: the caller's promise.
    unsafe { s.store(at, s.mul(exp(s, s.sub(s.load(at), most)), share)) }
}

dispatch! {
    /// Gradients of weights to gradients of scores, `weight * (gradient - mean)`: `mean` of a column is that of its
    /// gradients by their weights.
    ///
    /// # Safety
    /// the block can be written and as many `weights` read; `mean` is as long as a panel is wide.
    pub(super) unsafe fn to_score_gradients = to_score_gradients_kernel(block: Block, weights: *const f32, mean: &[f32])
}

#[inline(always)]
unsafe fn to_score_gradients_kernel<S: Simd>(s: S, block: Block, weights: *const f32, mean: &[f32]) {
    let width = mean.len();
    for x in (0..width).step_by(S::LANES) {
        // SAFETY: the caller's promise.
        unsafe {
            let mean = s.load(mean[x..].as_ptr());
            for row in 0..block.rows {
                let at = block.scores.add(row * width + x);
                let weight = s.load(weights.add(row * width + x));
                s.store(at, s.mul(weight, s.sub(s.load(at), mean)));
            }
        }
    }
}
