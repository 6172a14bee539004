//! The attention weights of one image: computed once, then applied to many values.

use std::sync::OnceLock;

use rayon::prelude::*;
use srflow_simd::{
    Activation, Isa, Output, Packed, Precision, Product, SharedMut, Start, Steps, fill_columns, multiply,
    panel_columns,
};

use super::panels::{BLOCK, ChannelsAsRows, Group, PANELS, blocks, to_panels};
use super::softmax::{Normal, add_to_sums, weigh};

/// The attention weights between all pixels of one image.
#[derive(Debug)]
pub(crate) struct AttentionWeights {
    pub(super) isa: Isa,
    pub(super) precision: Precision,
    pub(super) pixels: usize,
    sums: Sums,
    kept_bytes: usize,
    by_query: Side,
    /// For the gradients of values.
    by_key: OnceLock<Side>,
}

/// The softmax statistics of each query, in whole panels.
#[derive(Debug)]
pub(super) struct Sums {
    /// The largest score.
    pub(super) maxima: Vec<f32>,
    /// The inverse of the sum of `exp(score - maximum)`.
    pub(super) inverse_sums: Vec<f32>,
}

/// Products of pixels in panels with all pixels in blocks: `sum_c columns_ci rows_cj`.
#[derive(Debug)]
pub(super) struct Pairs {
    isa: Isa,
    channels: usize,
    /// Panel by panel, `[channels, columns]`.
    columns: Vec<f32>,
    /// `[pixels, channels]`.
    rows: Packed,
}

/// Weights with the queries in the columns of panels and the keys in rows, or vice versa.
#[derive(Debug)]
struct Side {
    scores: Pairs,
    queries: Queries,
    /// The weights of the first panels, which are kept, each `[pixels, columns of the panel]`.
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
    pub(super) fn new(isa: Isa, precision: Precision, columns: &[f32], rows: &[f32], pixels: usize) -> Self {
        Self {
            isa,
            channels: columns.len() / pixels,
            columns: to_panels(isa, columns, pixels),
            rows: Packed::columns(isa, precision, rows, pixels),
        }
    }

    /// The products of the block's pixels with a group's, `[block, columns]` for each panel.
    pub(super) fn multiply(
        &self,
        group: Group,
        (first, len): (usize, usize),
        start: Start,
        out: &mut Output,
    ) {
        let width = panel_columns(self.isa);
        let product = Product {
            left: self.rows.part(0).after_rows(first, self.channels),
            rows: len,
            depth: self.channels,
            right: &self.columns[group.first * self.channels * width..],
            right_panel: self.channels * width,
            start,
            add: None,
            activation: Activation::Identity,
            columns: group.panels * width,
        };
        multiply(self.isa, &product, out);
    }
}

/// Values to be summed with weights.
pub(super) struct Gathering<'a> {
    pub(super) isa: Isa,
    /// In the blocks that are added.
    pub(super) values: &'a ChannelsAsRows,
}

impl Gathering<'_> {
    /// Adds the weighted values of a block of pixels to the output of a group, or initialises it. `weights` are `[block, columns]`,
    /// panel after panel, `step` elements apart; `out` begins at the group's first pixel.
    pub(super) fn add(
        &self,
        group: Group,
        (first, len): (usize, usize),
        weights: &[f32],
        step: usize,
        out: &mut Output,
    ) {
        let product = Product {
            left: self.values.block_at(first),
            rows: self.values.channels,
            depth: len,
            right: weights,
            right_panel: step,
            start: if first == 0 { Start::Zero } else { Start::Output },
            add: None,
            activation: Activation::Identity,
            columns: group.columns,
        };
        multiply(self.isa, &product, out);
    }
}

impl Sums {
    /// Before the first score of each column.
    pub(super) fn of_nothing(columns: usize) -> Self {
        Self { maxima: vec![f32::MIN; columns], inverse_sums: vec![0.0; columns] }
    }

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
                Normal::OfColumns {
                    maxima: &self.maxima[columns.clone()],
                    inverse_sums: &self.inverse_sums[columns],
                }
            }
            Queries::InRows => {
                let rows = first..first + len;
                Normal::OfRows { maxima: &self.maxima[rows.clone()], inverse_sums: &self.inverse_sums[rows] }
            }
        }
    }
}

/// Sums of exponentials to their inverses.
pub(super) fn invert(sums: &mut [f32], maxima: &[f32]) {
    for (sum, maximum) in sums.iter_mut().zip(maxima) {
        // If all scores are minus infinity, the weights are NaN, as in the definition.
        *sum = if *maximum == f32::MIN { f32::NAN } else { 1.0 / *sum };
    }
}

/// Number of panels of `pixels` that fit in `kept_bytes`: all, or whole groups.
fn panels_within(isa: Isa, pixels: usize, kept_bytes: usize) -> usize {
    let panels = pixels.div_ceil(panel_columns(isa));
    let within = kept_bytes / size_of::<f32>() / (pixels * panel_columns(isa));
    if within >= panels { panels } else { within / PANELS * PANELS }
}

impl AttentionWeights {
    /// From queries and keys, each `[channels, pixels]`. Keeps at most `kept_bytes` of weights, and as many again for the
    /// gradients. Panics when the length of a slice does not match.
    pub(crate) fn new(
        isa: Isa,
        precision: Precision,
        [queries, keys]: [&[f32]; 2],
        pixels: usize,
        kept_bytes: usize,
    ) -> Self {
        assert!(pixels > 0 && queries.len().is_multiple_of(pixels), "queries of {pixels} pixels");
        assert_eq!(queries.len(), keys.len(), "as many keys as queries");
        let width = panel_columns(isa);
        let scores = Pairs::new(isa, precision, queries, keys, pixels);
        let panel_len = pixels * width;
        let kept_panels = panels_within(isa, pixels, kept_bytes);
        let columns = pixels.div_ceil(width) * width;
        let mut sums = Sums::of_nothing(columns);
        let fill = |kept: SharedMut| {
            let maxima = sums.maxima.par_chunks_mut(PANELS * width);
            let groups = maxima.zip(sums.inverse_sums.par_chunks_mut(PANELS * width));
            groups.enumerate().for_each_init(
                || vec![0.0; PANELS * BLOCK * width],
                |scratch, (number, (maxima, sums))| {
                    let group = Group::of(isa, number, pixels);
                    let keep = group.first < kept_panels;
                    for block @ (first, len) in blocks(pixels) {
                        let (scratch, step) = (scratch.as_mut_slice(), BLOCK * width);
                        if keep {
                            let at = group.first * panel_len + first * width;
                            // SAFETY: kept weights of this group belong to this task.
                            let mut out = unsafe { kept.output(at, Steps { row: width, panel: panel_len }) };
                            scores.multiply(group, block, Start::Zero, &mut out);
                        } else {
                            let mut out = Output::new(scratch, Steps { row: width, panel: step });
                            scores.multiply(group, block, Start::Zero, &mut out);
                        }
                        for panel in 0..group.panels {
                            let columns = panel * width..(panel + 1) * width;
                            let scores = if keep {
                                let at = kept.at((group.first + panel) * panel_len + first * width);
                                // SAFETY: these rows of the panel were just written, and belong to this task.
                                unsafe { std::slice::from_raw_parts(at, len * width) }
                            } else {
                                &scratch[panel * step..][..len * width]
                            };
                            add_to_sums(isa, scores, &mut maxima[columns.clone()], &mut sums[columns]);
                        }
                    }
                    invert(sums, maxima);
                    for panel in 0..if keep { group.panels } else { 0 } {
                        let columns = panel * width..(panel + 1) * width;
                        let normal = Normal::OfColumns {
                            maxima: &maxima[columns.clone()],
                            inverse_sums: &sums[columns],
                        };
                        let at = kept.at((group.first + panel) * panel_len);
                        // SAFETY: all blocks of the panel were written above, and belong to this task.
                        weigh(isa, unsafe { std::slice::from_raw_parts_mut(at, panel_len) }, width, normal);
                    }
                },
            );
        };
        // SAFETY: each group writes its panels, all pixels of them.
        let kept = unsafe { SharedMut::fill_new(kept_panels * panel_len, fill) };
        let by_query = Side { scores, queries: Queries::InColumns, kept, kept_panels };
        Self { isa, precision, pixels, sums, kept_bytes, by_query, by_key: OnceLock::new() }
    }

    /// Of sums that are known; nothing is kept.
    pub(super) fn of_sums(
        isa: Isa,
        precision: Precision,
        [queries, keys]: [&[f32]; 2],
        pixels: usize,
        sums: Sums,
    ) -> Self {
        let scores = Pairs::new(isa, precision, queries, keys, pixels);
        let by_query = Side { scores, queries: Queries::InColumns, kept: Vec::new(), kept_panels: 0 };
        Self { isa, precision, pixels, sums, kept_bytes: 0, by_query, by_key: OnceLock::new() }
    }

    /// `ln sum_j exp(q_i . k_j)` for each pixel.
    pub(crate) fn log_sums(&self) -> Vec<f32> {
        let Sums { maxima, inverse_sums } = &self.sums;
        let sums = maxima.iter().zip(inverse_sums).map(|(maximum, inverse)| maximum - inverse.ln());
        sums.take(self.pixels).collect()
    }

    /// The weighted sum of `values` (`[channels, pixels]`) for each pixel, likewise `[channels, pixels]`. Panics when the length
    /// of the slice does not match.
    pub(crate) fn gather(&self, values: &[f32]) -> Vec<f32> {
        self.gather_from(&self.by_query, values)
    }

    /// The gradient of the values, given that of the output. Queries and keys are those of [`Self::new`].
    pub(crate) fn gather_backward(&self, queries: &[f32], keys: &[f32], grad: &[f32]) -> Vec<f32> {
        self.gather_from(self.by_key.get_or_init(|| self.new_by_key(queries, keys)), grad)
    }

    fn new_by_key(&self, queries: &[f32], keys: &[f32]) -> Side {
        let Self { isa, precision, pixels, .. } = *self;
        let panel_len = pixels * panel_columns(isa);
        let kept_panels = panels_within(isa, pixels, self.kept_bytes);
        let (scores, queries) = (Pairs::new(isa, precision, keys, queries, pixels), Queries::InRows);
        let group_len = PANELS * panel_len;
        let mut kept = vec![0.0; kept_panels * panel_len];
        kept.par_chunks_mut(group_len.max(1)).enumerate().for_each(|(number, kept)| {
            let group = Group::of(isa, number, pixels);
            for block @ (first, _) in blocks(pixels) {
                self.compute(
                    &scores,
                    queries,
                    group,
                    block,
                    &mut kept[first * panel_columns(isa)..],
                    panel_len,
                );
            }
        });
        Side { scores, queries, kept, kept_panels }
    }

    /// Computes the weights of the block's pixels and a group's: `[block, columns]`, panel after panel, `step` elements apart.
    fn compute(
        &self,
        scores: &Pairs,
        queries: Queries,
        group: Group,
        block: (usize, usize),
        out: &mut [f32],
        step: usize,
    ) {
        let width = panel_columns(self.isa);
        let steps = Steps { row: width, panel: step };
        scores.multiply(group, block, Start::Zero, &mut Output::new(out, steps));
        for panel in 0..group.panels {
            let normal = self.sums.of(queries, group, block, panel, width);
            weigh(self.isa, &mut out[panel * step..][..block.1 * width], width, normal);
        }
    }

    /// The weights of the block's pixels and a group's, and the number of elements from one panel to the next: kept, or else
    /// computed into the scratch buffer.
    fn of_block<'a>(
        &self,
        side: &'a Side,
        group: Group,
        block: (usize, usize),
        scratch: &'a mut [f32],
    ) -> (&'a [f32], usize) {
        let width = panel_columns(self.isa);
        if group.first < side.kept_panels {
            let panel_len = self.pixels * width;
            return (&side.kept[group.first * panel_len + block.0 * width..], panel_len);
        }
        self.compute(&side.scores, side.queries, group, block, scratch, BLOCK * width);
        (scratch, BLOCK * width)
    }

    /// [`Self::of_block`] with the queries in columns.
    pub(super) fn of_queries<'a>(
        &'a self,
        group: Group,
        block: (usize, usize),
        scratch: &'a mut [f32],
    ) -> (&'a [f32], usize) {
        self.of_block(&self.by_query, group, block, scratch)
    }

    fn gather_from(&self, side: &Side, values: &[f32]) -> Vec<f32> {
        let Self { isa, precision, pixels, .. } = *self;
        assert!(values.len().is_multiple_of(pixels), "values of {pixels} pixels");
        let values = ChannelsAsRows::new(isa, precision, values, pixels, BLOCK);
        let gathering = Gathering { isa, values: &values };
        let width = panel_columns(isa);
        let sizes = [1, values.channels, pixels];
        let scratch = || vec![0.0; PANELS * BLOCK * width];
        fill_columns(isa, sizes, PANELS * width, scratch, |scratch, _, own, out| {
            let group = Group::of(isa, own.start / (PANELS * width), pixels);
            for block in blocks(pixels) {
                let (weights, step) = self.of_block(side, group, block, scratch);
                gathering.add(group, block, weights, step, out);
            }
        })
    }

    /// Size in bytes of the kept weights.
    #[cfg(test)]
    pub(super) fn kept_bytes(&self) -> usize {
        let by_key = self.by_key.get().map_or(0, |side| side.kept.len());
        (self.by_query.kept.len() + by_key) * size_of::<f32>()
    }
}
