//! What stands between scores and weights: the exponential, its sums, and the way back.

use crate::activation::exp;
use crate::simd::{Simd, dispatch};

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
    /// `isa` is available; the block can be read; both slices are as long as a panel is wide.
    pub(super) fn add_to_sums = add_to_sums_kernel(block: Block, most: &mut [f32], sums: &mut [f32])
}

#[inline(always)]
unsafe fn add_to_sums_kernel<S: Simd>(block: Block, most: &mut [f32], sums: &mut [f32]) {
    let width = most.len();
    for x in (0..width).step_by(S::LANES) {
        // SAFETY: the caller's promise.
        unsafe {
            let before = S::load(most[x..].as_ptr());
            let mut largest = before;
            for row in 0..block.rows {
                largest = S::max(largest, S::load(block.scores.add(row * width + x)));
            }
            // Before the first block the difference is infinite, and the sum zero.
            let mut sum = S::mul(S::load(sums[x..].as_ptr()), exp::<S>(S::sub(before, largest)));
            for row in 0..block.rows {
                sum = S::add(sum, exp::<S>(S::sub(S::load(block.scores.add(row * width + x)), largest)));
            }
            S::store(most[x..].as_mut_ptr(), largest);
            S::store(sums[x..].as_mut_ptr(), sum);
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
    /// `isa` is available; the block can be written; `width` is that of a panel, and `normal` as long as the panel is wide
    /// or the block has rows.
    pub(super) fn weigh = weigh_kernel(block: Block, width: usize, normal: Normal)
}

#[inline(always)]
unsafe fn weigh_kernel<S: Simd>(block: Block, width: usize, normal: Normal) {
    // SAFETY: the caller's promise.
    unsafe {
        match normal {
            Normal::OfColumns { most, share } => {
                for x in (0..width).step_by(S::LANES) {
                    let (most, share) = (S::load(most[x..].as_ptr()), S::load(share[x..].as_ptr()));
                    for row in 0..block.rows {
                        weigh_vector::<S>(block.scores.add(row * width + x), most, share);
                    }
                }
            }
            Normal::OfRows { most, share } => {
                for row in 0..block.rows {
                    let (most, share) = (S::splat(most[row]), S::splat(share[row]));
                    for x in (0..width).step_by(S::LANES) {
                        weigh_vector::<S>(block.scores.add(row * width + x), most, share);
                    }
                }
            }
        }
    }
}

#[inline(always)]
unsafe fn weigh_vector<S: Simd>(at: *mut f32, most: S::Vector, share: S::Vector) {
    // SAFETY: the caller's promise.
    unsafe { S::store(at, S::mul(exp::<S>(S::sub(S::load(at), most)), share)) }
}

dispatch! {
    /// Gradients of weights to gradients of scores, `weight * (gradient - mean)`: `mean` of a column is that of its
    /// gradients by their weights.
    ///
    /// # Safety
    /// `isa` is available; the block can be written and as many `weights` read; `mean` is as long as a panel is wide.
    pub(super) fn to_score_gradients = to_score_gradients_kernel(block: Block, weights: *const f32, mean: &[f32])
}

#[inline(always)]
unsafe fn to_score_gradients_kernel<S: Simd>(block: Block, weights: *const f32, mean: &[f32]) {
    let width = mean.len();
    for x in (0..width).step_by(S::LANES) {
        // SAFETY: the caller's promise.
        unsafe {
            let mean = S::load(mean[x..].as_ptr());
            for row in 0..block.rows {
                let at = block.scores.add(row * width + x);
                let weight = S::load(weights.add(row * width + x));
                S::store(at, S::mul(weight, S::sub(S::load(at), mean)));
            }
        }
    }
}
