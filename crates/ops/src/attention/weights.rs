//! Weights of one image: found once, then used for many values.

use std::sync::OnceLock;

use rayon::prelude::*;
use srflow_simd::{Activation, Isa, Product, SharedMut, Start, Steps, multiply, panel_columns};

use super::panels::{BLOCK, Group, PANELS, blocks, channels_as_rows, pixels_as_rows, to_panels};
use super::softmax::{Block, Normal, add_to_sums, weigh};

/// How much of each pixel every pixel of one image takes.
#[derive(Debug)]
pub(crate) struct AttentionWeights {
    pub(super) isa: Isa,
    pub(super) pixels: usize,
    sums: Sums,
    kept_bytes: usize,
    by_query: Side,
    /// For the gradients of values.
    by_key: OnceLock<Side>,
}

/// What the weights of a query depend on beside the score, for each query, in whole panels.
#[derive(Debug)]
struct Sums {
    /// The largest score.
    most: Vec<f32>,
    /// One over the sum of `exp(score - most)`.
    share: Vec<f32>,
}

/// Products of pixels in panels with all pixels in blocks: `sum_c columns_ci rows_cj`.
#[derive(Debug)]
pub(super) struct Pairs {
    isa: Isa,
    channels: usize,
    /// Panel by panel, `[channels, columns]`.
    columns: Vec<f32>,
    /// `[pixels, channels]` as `pack_rows` orders it.
    rows: Vec<f32>,
}

/// Weights with the queries in the columns of panels and the keys in rows, or the other way round.
#[derive(Debug)]
struct Side {
    scores: Pairs,
    queries: Queries,
    /// Panels from the first whose weights are kept, each `[pixels, columns of the panel]`.
    kept: Vec<f32>,
    kept_panels: usize,
}

#[derive(Debug, Clone, Copy)]
enum Queries {
    InColumns,
    InRows,
}

impl Pairs {
    /// Of `[channels, pixels]` each.
    pub(super) fn new(isa: Isa, columns: &[f32], rows: &[f32], pixels: usize) -> Self {
        Self {
            isa,
            channels: columns.len() / pixels,
            columns: to_panels(isa, columns, pixels),
            rows: pixels_as_rows(isa, rows, pixels),
        }
    }

    /// The products of the block's pixels with a group's: `[block, columns]`, panel after panel, `step` elements apart.
    ///
    /// # Safety
    /// `out` can be written, and read when the sums start from it.
    pub(super) unsafe fn multiply(
        &self,
        group: Group,
        (first, len): (usize, usize),
        start: Start,
        out: *mut f32,
        step: usize,
    ) {
        let width = panel_columns(self.isa);
        let product = Product {
            left: self.rows[first * self.channels..].as_ptr(),
            rows: len,
            depth: self.channels,
            right: self.columns[group.first * self.channels * width..].as_ptr(),
            right_panel: self.channels * width,
            start,
            add: None,
            activation: Activation::Identity,
            out,
            out_steps: Steps { row: width, panel: step },
            columns: group.panels * width,
        };
        // SAFETY: the caller's promise; the panels are whole.
        unsafe { multiply(self.isa, &product) }
    }
}

/// Values on their way to the pixels that gather them.
pub(super) struct Gathering<'a> {
    pub(super) isa: Isa,
    pub(super) pixels: usize,
    /// All values as [`channels_as_rows`] packs them.
    pub(super) values: &'a [f32],
    /// `[channels, pixels]`.
    pub(super) out: SharedMut<'a>,
}

impl Gathering<'_> {
    /// Adds to what the group's pixels have gathered, or starts with, the values of a block of pixels. `weights` are
    /// `[block, columns]`, panel after panel, `step` elements apart.
    ///
    /// # Safety
    /// The weights can be read; the group's pixels of the output belong to the calling thread.
    pub(super) unsafe fn add(
        &self,
        group: Group,
        (first, len): (usize, usize),
        weights: *const f32,
        step: usize,
    ) {
        let width = panel_columns(self.isa);
        let channels = self.values.len() / self.pixels;
        // SAFETY: the caller's promise; the weights are whole panels, the output is cut to the group's columns.
        unsafe {
            let product = Product {
                left: self.values[first * channels..].as_ptr(),
                rows: channels,
                depth: len,
                right: weights,
                right_panel: step,
                start: if first == 0 { Start::Zero } else { Start::Output },
                add: None,
                activation: Activation::Identity,
                out: self.out.at(group.first * width),
                out_steps: Steps { row: self.pixels, panel: width },
                columns: group.columns,
            };
            multiply(self.isa, &product)
        }
    }
}

impl Sums {
    fn of(
        &self,
        queries: Queries,
        group: Group,
        (first, len): (usize, usize),
        panel: usize,
        width: usize,
    ) -> Normal<'_> {
        match queries {
            Queries::InColumns => {
                let columns = (group.first + panel) * width..(group.first + panel + 1) * width;
                Normal::OfColumns { most: &self.most[columns.clone()], share: &self.share[columns] }
            }
            Queries::InRows => {
                let rows = first..first + len;
                Normal::OfRows { most: &self.most[rows.clone()], share: &self.share[rows] }
            }
        }
    }
}

/// Panels of `pixels` that `kept_bytes` hold: all, or whole groups.
fn panels_within(isa: Isa, pixels: usize, kept_bytes: usize) -> usize {
    let panels = pixels.div_ceil(panel_columns(isa));
    let within = kept_bytes / size_of::<f32>() / (pixels * panel_columns(isa));
    if within >= panels { panels } else { within / PANELS * PANELS }
}

impl AttentionWeights {
    /// From queries and keys, each `[channels, pixels]`. At most `kept_bytes` of weights are kept, and as many again for the
    /// gradients. Panics when a slice does not fit.
    pub(crate) fn new(isa: Isa, queries: &[f32], keys: &[f32], pixels: usize, kept_bytes: usize) -> Self {
        assert!(pixels > 0 && queries.len().is_multiple_of(pixels), "queries of {pixels} pixels");
        assert_eq!(queries.len(), keys.len(), "as many keys as queries");
        let width = panel_columns(isa);
        let scores = Pairs::new(isa, queries, keys, pixels);
        let panel_len = pixels * width;
        let kept_panels = panels_within(isa, pixels, kept_bytes);
        let columns = pixels.div_ceil(width) * width;
        let mut sums = Sums { most: vec![f32::NEG_INFINITY; columns], share: vec![0.0; columns] };
        let fill = |kept: SharedMut| {
            let most = sums.most.par_chunks_mut(PANELS * width);
            let groups = most.zip(sums.share.par_chunks_mut(PANELS * width));
            groups.enumerate().for_each_init(
                || vec![0.0; PANELS * BLOCK * width],
                |scratch, (number, (most, share))| {
                    let group = Group::of(isa, number, pixels);
                    let keep = group.first < kept_panels;
                    for block @ (first, len) in blocks(pixels) {
                        // SAFETY: kept weights of this group, or the scratch, belong to this task.
                        unsafe {
                            let (out, step) = if keep {
                                (kept.at(group.first * panel_len + first * width), panel_len)
                            } else {
                                (scratch.as_mut_ptr(), BLOCK * width)
                            };
                            scores.multiply(group, block, Start::Zero, out, step);
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
                            let normal =
                                Normal::OfColumns { most: &most[columns.clone()], share: &share[columns] };
                            weigh(isa, block, width, normal);
                        }
                    }
                },
            );
        };
        // SAFETY: each group writes its panels, all pixels of them.
        let kept = unsafe { SharedMut::fill_new(kept_panels * panel_len, fill) };
        let by_query = Side { scores, queries: Queries::InColumns, kept, kept_panels };
        Self { isa, pixels, sums, kept_bytes, by_query, by_key: OnceLock::new() }
    }

    /// What each pixel gathers of `values` (`[channels, pixels]`), likewise. Panics when the slice does not fit.
    pub(crate) fn gather(&self, values: &[f32]) -> Vec<f32> {
        self.gather_from(&self.by_query, values)
    }

    /// The gradient of the values, from that of what was gathered of them. Queries and keys are those of [`Self::new`].
    pub(crate) fn gather_backward(&self, queries: &[f32], keys: &[f32], grad: &[f32]) -> Vec<f32> {
        self.gather_from(self.by_key.get_or_init(|| self.new_by_key(queries, keys)), grad)
    }

    fn new_by_key(&self, queries: &[f32], keys: &[f32]) -> Side {
        let (isa, pixels) = (self.isa, self.pixels);
        let panel_len = pixels * panel_columns(isa);
        let kept_panels = panels_within(isa, pixels, self.kept_bytes);
        let mut side = Side {
            scores: Pairs::new(isa, keys, queries, pixels),
            queries: Queries::InRows,
            kept: Vec::new(),
            kept_panels: 0,
        };
        let fill = |kept: SharedMut| {
            (0..kept_panels.div_ceil(PANELS)).into_par_iter().for_each(|number| {
                let group = Group::of(isa, number, pixels);
                for block @ (first, _) in blocks(pixels) {
                    // SAFETY: the group's panels belong to this task.
                    unsafe {
                        let out = kept.at(group.first * panel_len + first * panel_columns(isa));
                        self.compute(&side, group, block, out, panel_len);
                    }
                }
            });
        };
        // SAFETY: each group writes its panels, all pixels of them; the kept panels are whole groups, or all.
        side.kept = unsafe { SharedMut::fill_new(kept_panels * panel_len, fill) };
        side.kept_panels = kept_panels;
        side
    }

    /// Weights of the block's pixels and a group's: `[block, columns]`, panel after panel, `step` elements apart.
    ///
    /// # Safety
    /// `out` can be written.
    unsafe fn compute(&self, side: &Side, group: Group, block: (usize, usize), out: *mut f32, step: usize) {
        let width = panel_columns(self.isa);
        // SAFETY: the caller's promise.
        unsafe {
            side.scores.multiply(group, block, Start::Zero, out, step);
            for panel in 0..group.panels {
                let normal = self.sums.of(side.queries, group, block, panel, width);
                let block = Block { scores: out.add(panel * step), rows: block.1 };
                weigh(self.isa, block, width, normal);
            }
        }
    }

    /// Where the weights of the block's pixels and a group's lie, and the elements from a panel to the next: kept, or else
    /// computed into the scratch.
    fn of_block(
        &self,
        side: &Side,
        group: Group,
        block: (usize, usize),
        scratch: &mut [f32],
    ) -> (*const f32, usize) {
        let width = panel_columns(self.isa);
        if group.first < side.kept_panels {
            let panel_len = self.pixels * width;
            return (side.kept[group.first * panel_len + block.0 * width..].as_ptr(), panel_len);
        }
        assert!(scratch.len() >= PANELS * BLOCK * width);
        // SAFETY: the scratch holds a block of a group.
        unsafe { self.compute(side, group, block, scratch.as_mut_ptr(), BLOCK * width) }
        (scratch.as_ptr(), BLOCK * width)
    }

    /// [`Self::of_block`] with the queries in columns.
    pub(super) fn of_queries(
        &self,
        group: Group,
        block: (usize, usize),
        scratch: &mut [f32],
    ) -> (*const f32, usize) {
        self.of_block(&self.by_query, group, block, scratch)
    }

    fn gather_from(&self, side: &Side, values: &[f32]) -> Vec<f32> {
        let (isa, pixels) = (self.isa, self.pixels);
        assert!(values.len().is_multiple_of(pixels), "values of {pixels} pixels");
        let packed = channels_as_rows(isa, values, pixels, BLOCK);
        let fill = |out: SharedMut| {
            let gathering = Gathering { isa, pixels, values: &packed, out };
            (0..Group::count(isa, pixels)).into_par_iter().for_each_init(
                || vec![0.0; PANELS * BLOCK * panel_columns(isa)],
                |scratch, number| {
                    let group = Group::of(isa, number, pixels);
                    for block in blocks(pixels) {
                        let (weights, step) = self.of_block(side, group, block, scratch);
                        // SAFETY: the group's pixels are this task's.
                        unsafe { gathering.add(group, block, weights, step) }
                    }
                },
            );
        };
        // SAFETY: the groups cover every pixel, and write all channels of each.
        unsafe { SharedMut::fill_new(values.len(), fill) }
    }

    /// Bytes of the weights that are kept.
    #[cfg(test)]
    pub(super) fn kept_bytes(&self) -> usize {
        let by_key = self.by_key.get().map_or(0, |side| side.kept.len());
        (self.by_query.kept.len() + by_key) * size_of::<f32>()
    }
}
