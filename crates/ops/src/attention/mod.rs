//! Attention between the pixels of an image: `out_i = sum_j softmax_j(q_i . k_j) v_j`, without the matrix of all pairs.
//!
//! Pairs are computed in blocks that stay in the cache. What the weights depend on beside queries and keys, the largest
//! score of each pixel and the sum of the exponentials, is found once; a pass over values then needs each pair once. As
//! many weights as are allowed for are kept, since the networks gather different values with the same weights many times.
//! [`mod@reference`] is the definition.

use rayon::prelude::*;

use crate::activation::{Activation, exp};
use crate::gemm::{Product, Start, Steps, multiply, pack_rows, panel_columns};
use crate::shared_mut::SharedMut;
use crate::simd::{Isa, Simd, dispatch};

pub mod reference;
pub mod tensor;

/// Panels of pixels of one piece of work.
const PANELS: usize = 4;
/// Pixels that are attended to at a time; a multiple of every register tile.
const BLOCK: usize = 256;

/// How much of each pixel every pixel of one image takes.
#[derive(Debug)]
pub(crate) struct AttentionWeights {
    isa: Isa,
    pixels: usize,
    side: Side,
    /// Panels from the first whose weights are kept, each `[pixels, columns of the panel]`.
    kept: Vec<f32>,
    kept_panels: usize,
}

/// Scores of pixels in panels against all pixels in blocks.
#[derive(Debug)]
struct Side {
    channels: usize,
    /// Panel by panel, `[channels, columns]`.
    panels: Vec<f32>,
    /// `[pixels, channels]` as [`pack_rows`] orders it.
    rows: Vec<f32>,
    /// The largest score of each pixel.
    most: Vec<f32>,
    /// One over the sum of `exp(score - most)`.
    share: Vec<f32>,
}

/// `[rows, pixels]` to panels `[rows, columns]`; what the last panel lacks is zero.
fn to_panels(isa: Isa, matrix: &[f32], pixels: usize) -> Vec<f32> {
    let width = panel_columns(isa);
    let rows = matrix.len() / pixels;
    let mut panels = vec![0.0; pixels.div_ceil(width) * rows * width];
    panels.par_chunks_mut(rows * width).enumerate().for_each(|(number, panel)| {
        let first = number * width;
        let count = width.min(pixels - first);
        for (to, from) in panel.chunks_exact_mut(width).zip(matrix.chunks_exact(pixels)) {
            to[..count].copy_from_slice(&from[first..first + count]);
        }
    });
    panels
}

/// `[channels, pixels]` as a left side with a row for each pixel.
fn pixels_as_rows(isa: Isa, matrix: &[f32], pixels: usize) -> Vec<f32> {
    let channels = matrix.len() / pixels;
    let mut packed = vec![0.0; matrix.len()];
    packed.par_chunks_mut(BLOCK * channels).enumerate().for_each(|(block, packed)| {
        let first = block * BLOCK;
        let rows: Vec<f32> = (first..first + packed.len() / channels)
            .flat_map(|pixel| matrix[pixel..].iter().step_by(pixels).copied())
            .collect();
        pack_rows(isa, &rows, channels, packed);
    });
    packed
}

/// `[channels, pixels]` as a left side with a row for each channel, block of pixels by block of pixels.
fn channels_as_rows(isa: Isa, matrix: &[f32], pixels: usize) -> Vec<f32> {
    let channels = matrix.len() / pixels;
    let mut packed = vec![0.0; matrix.len()];
    packed.par_chunks_mut(BLOCK * channels).enumerate().for_each(|(block, packed)| {
        let depth = packed.len() / channels;
        let rows: Vec<f32> = matrix
            .chunks_exact(pixels)
            .flat_map(|plane| plane[block * BLOCK..block * BLOCK + depth].iter().copied())
            .collect();
        pack_rows(isa, &rows, depth, packed);
    });
    packed
}

/// The columns of panels from `first`, at most [`PANELS`] of them.
#[derive(Clone, Copy)]
struct Group {
    first: usize,
    panels: usize,
    columns: usize,
}

impl Group {
    fn of(isa: Isa, number: usize, pixels: usize) -> Self {
        let width = panel_columns(isa);
        let first = number * PANELS;
        let columns = (PANELS * width).min(pixels - first * width);
        Self { first, panels: columns.div_ceil(width), columns }
    }

    fn count(isa: Isa, pixels: usize) -> usize {
        pixels.div_ceil(PANELS * panel_columns(isa))
    }
}

/// Blocks of `pixels`: the first pixel and how many.
fn blocks(pixels: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..pixels).step_by(BLOCK).map(move |first| (first, BLOCK.min(pixels - first)))
}

impl Side {
    /// Scores of the block's pixels against a group's: `[block, columns]`, panel after panel, `step` elements apart.
    ///
    /// # Safety
    /// `isa` is available; `out` can be written.
    unsafe fn scores(
        &self,
        isa: Isa,
        group: Group,
        (first, len): (usize, usize),
        out: *mut f32,
        step: usize,
    ) {
        let width = panel_columns(isa);
        let product = Product {
            left: self.rows[first * self.channels..].as_ptr(),
            rows: len,
            depth: self.channels,
            right: self.panels[group.first * self.channels * width..].as_ptr(),
            right_panel: self.channels * width,
            start: Start::Zero,
            add: None,
            activation: Activation::Identity,
            out,
            out_steps: Steps { row: width, panel: step },
            columns: group.panels * width,
        };
        // SAFETY: the caller's promise; the panels are whole.
        unsafe { multiply(isa, &product) }
    }
}

impl AttentionWeights {
    /// From queries and keys, each `[channels, pixels]`. At most `kept_bytes` of weights are kept. Panics when a slice does
    /// not fit.
    pub(crate) fn new(isa: Isa, queries: &[f32], keys: &[f32], pixels: usize, kept_bytes: usize) -> Self {
        assert!(pixels > 0 && queries.len().is_multiple_of(pixels), "queries of {pixels} pixels");
        assert_eq!(queries.len(), keys.len(), "as many keys as queries");
        let width = panel_columns(isa);
        let mut side = Side {
            channels: queries.len() / pixels,
            panels: to_panels(isa, queries, pixels),
            rows: pixels_as_rows(isa, keys, pixels),
            most: Vec::new(),
            share: Vec::new(),
        };
        let panels = pixels.div_ceil(width);
        let panel_len = pixels * width;
        let kept_panels = if kept_bytes / size_of::<f32>() >= panels * panel_len {
            panels
        } else {
            kept_bytes / size_of::<f32>() / panel_len / PANELS * PANELS
        };
        let mut most = vec![f32::NEG_INFINITY; panels * width];
        let mut share = vec![0.0; panels * width];
        let fill = |kept: SharedMut| {
            let groups = most.par_chunks_mut(PANELS * width).zip(share.par_chunks_mut(PANELS * width));
            groups.enumerate().for_each_init(
                || vec![0.0; PANELS * BLOCK * width],
                |scores, (number, (most, share))| {
                    let group = Group::of(isa, number, pixels);
                    let keep = group.first < kept_panels;
                    for block @ (first, len) in blocks(pixels) {
                        // SAFETY: `isa` is available; kept weights of this group, or the scratch, belong to this task.
                        unsafe {
                            let (out, step) = if keep {
                                (kept.at(group.first * panel_len + first * width), panel_len)
                            } else {
                                (scores.as_mut_ptr(), BLOCK * width)
                            };
                            side.scores(isa, group, block, out, step);
                            for panel in 0..group.panels {
                                let columns = panel * width..(panel + 1) * width;
                                let block = Block { scores: out.add(panel * step), rows: len };
                                add_to_sums(isa, block, &mut most[columns.clone()], &mut share[columns]);
                            }
                        }
                    }
                    share.iter_mut().for_each(|share| *share = 1.0 / *share);
                    for panel in 0..if keep { group.panels } else { 0 } {
                        let columns = panel * width..(panel + 1) * width;
                        // SAFETY: as above.
                        unsafe {
                            let scores = kept.at((group.first + panel) * panel_len);
                            let block = Block { scores, rows: pixels };
                            weigh(isa, block, &most[columns.clone()], Some(&share[columns]));
                        }
                    }
                },
            );
        };
        // SAFETY: each group writes its panels, all pixels of them.
        let kept = unsafe { SharedMut::fill_new(kept_panels * panel_len, fill) };
        (side.most, side.share) = (most, share);
        Self { isa, pixels, side, kept, kept_panels }
    }

    /// What each pixel gathers of `values` (`[channels, pixels]`), likewise. Panics when the slice does not fit.
    pub(crate) fn gather(&self, values: &[f32]) -> Vec<f32> {
        let (isa, pixels) = (self.isa, self.pixels);
        assert!(values.len().is_multiple_of(pixels), "values of {pixels} pixels");
        let channels = values.len() / pixels;
        let width = panel_columns(isa);
        let packed = channels_as_rows(isa, values, pixels);
        let fill = |target: SharedMut| {
            let scratch = || (vec![0.0; PANELS * BLOCK * width], vec![0.0; PANELS * channels * width]);
            (0..Group::count(isa, pixels)).into_par_iter().for_each_init(
                scratch,
                |(scores, sums), number| {
                    let group = Group::of(isa, number, pixels);
                    sums.fill(0.0);
                    let keep = group.first < self.kept_panels;
                    for block @ (first, len) in blocks(pixels) {
                        let (right, right_panel) = if keep {
                            (
                                self.kept[group.first * pixels * width + first * width..].as_ptr(),
                                pixels * width,
                            )
                        } else {
                            let step = BLOCK * width;
                            // SAFETY: `isa` is available; the scratch holds the block.
                            unsafe {
                                self.side.scores(isa, group, block, scores.as_mut_ptr(), step);
                                for panel in 0..group.panels {
                                    let most = &self.side.most[(group.first + panel) * width..][..width];
                                    let block =
                                        Block { scores: scores.as_mut_ptr().add(panel * step), rows: len };
                                    weigh(isa, block, most, None);
                                }
                            }
                            (scores.as_ptr(), step)
                        };
                        let product = Product {
                            left: packed[first * channels..].as_ptr(),
                            rows: channels,
                            depth: len,
                            right,
                            right_panel,
                            start: Start::Output,
                            add: None,
                            activation: Activation::Identity,
                            out: sums.as_mut_ptr(),
                            out_steps: Steps { row: width, panel: channels * width },
                            columns: group.panels * width,
                        };
                        // SAFETY: `isa` is available; both sides are whole panels.
                        unsafe { multiply(isa, &product) }
                    }
                    for column in 0..group.columns {
                        let pixel = group.first * width + column;
                        let share = if keep { 1.0 } else { self.side.share[pixel] };
                        let from = column / width * channels * width + column % width;
                        for channel in 0..channels {
                            // SAFETY: inside; this group's pixels are this task's.
                            unsafe {
                                *target.at(channel * pixels + pixel) = sums[from + channel * width] * share
                            }
                        }
                    }
                },
            );
        };
        // SAFETY: the groups cover every pixel, and write all channels of each.
        unsafe { SharedMut::fill_new(channels * pixels, fill) }
    }
}

/// Scores of one panel against neighbouring pixels, `[rows, columns of the panel]`.
#[derive(Clone, Copy)]
struct Block {
    scores: *mut f32,
    rows: usize,
}

dispatch! {
    /// Raises `most` to the largest score of each column, and adds `exp(score - most)` to `sums`, which are scaled to that.
    ///
    /// # Safety
    /// `isa` is available; the block can be read; both slices are as long as a panel is wide.
    fn add_to_sums = add_to_sums_kernel(block: Block, most: &mut [f32], sums: &mut [f32])
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

dispatch! {
    /// Scores to `exp(score - most)`, times `share` where it is given.
    ///
    /// # Safety
    /// `isa` is available; the block can be written; the slices are as long as a panel is wide.
    fn weigh = weigh_kernel(block: Block, most: &[f32], share: Option<&[f32]>)
}

#[inline(always)]
unsafe fn weigh_kernel<S: Simd>(block: Block, most: &[f32], share: Option<&[f32]>) {
    let width = most.len();
    for x in (0..width).step_by(S::LANES) {
        // SAFETY: the caller's promise.
        unsafe {
            let most = S::load(most[x..].as_ptr());
            let share = share.map_or(S::splat(1.0), |share| S::load(share[x..].as_ptr()));
            for row in 0..block.rows {
                let at = block.scores.add(row * width + x);
                S::store(at, S::mul(exp::<S>(S::sub(S::load(at), most)), share));
            }
        }
    }
}

/// `out_i = sum_j softmax_j(q_i . k_j) v_j` for every image. Queries and keys are `[batch, channels, pixels]`, values and
/// output `[batch, value channels, pixels]`. Panics when a slice does not fit.
pub fn attention(
    queries: &[f32],
    keys: &[f32],
    values: &[f32],
    [batch, channels, pixels]: [usize; 3],
) -> Vec<f32> {
    assert_eq!(queries.len(), batch * channels * pixels, "queries of {batch}x{channels}x{pixels}");
    assert!(values.len().is_multiple_of(batch * pixels), "values of {batch} images of {pixels} pixels");
    let image = channels * pixels;
    let values_image = values.len() / batch;
    let images =
        queries.chunks_exact(image).zip(keys.chunks_exact(image)).zip(values.chunks_exact(values_image));
    let gather = |((queries, keys), values)| {
        AttentionWeights::new(Isa::best(), queries, keys, pixels, 0).gather(values)
    };
    images.flat_map(gather).collect()
}

#[cfg(test)]
mod tests;
