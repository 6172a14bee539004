//! The attention weights of one image: computed once, then applied to many values.

use std::sync::OnceLock;

use rayon::prelude::*;
use srflow_simd::{
    Activation, Isa, Output, Packed, Pair, Precision, Product, Right, Scratch, Start, Steps, fill_columns,
    multiply, pair_rows, panel_columns,
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
    kept: Kept,
    kept_panels: usize,
}

/// The weights of the first panels, each `[pixels, columns of the panel]`, as they are multiplied with values.
#[derive(Debug)]
enum Kept {
    F32(Vec<f32>),
    Bf16(Vec<Pair>),
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
            right: Right::F32(&self.columns[group.first * self.channels * width..]),
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
        weights: Right,
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
fn panels_within(isa: Isa, precision: Precision, pixels: usize, kept_bytes: usize) -> usize {
    let panels = pixels.div_ceil(panel_columns(isa));
    let panel_bytes = panel_len(isa, precision, pixels) * size_of::<f32>();
    let within = kept_bytes / panel_bytes;
    if within >= panels { panels } else { within / PANELS * PANELS }
}

/// Elements of a kept panel; a number takes as much room as a pair.
fn panel_len(isa: Isa, precision: Precision, pixels: usize) -> usize {
    precision.packed(pixels) * panel_columns(isa)
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
        let columns = pixels.div_ceil(width) * width;
        let mut sums = Sums::of_nothing(columns);
        let maxima = sums.maxima.par_chunks_mut(PANELS * width);
        let groups = maxima.zip(sums.inverse_sums.par_chunks_mut(PANELS * width));
        groups.enumerate().for_each_init(
            || Scratch::of(PANELS * BLOCK * width),
            |scratch, (number, (maxima, sums))| {
                let group = Group::of(isa, number, pixels);
                let step = BLOCK * width;
                for block in blocks(pixels) {
                    let mut out = Output::new(scratch, Steps { row: width, panel: step });
                    scores.multiply(group, block, Start::Zero, &mut out);
                    for panel in 0..group.panels {
                        let columns = panel * width..(panel + 1) * width;
                        let scores = &scratch[panel * step..][..block.1 * width];
                        add_to_sums(isa, scores, &mut maxima[columns.clone()], &mut sums[columns]);
                    }
                }
                invert(sums, maxima);
            },
        );
        let by_query = Side::new(scores, Queries::InColumns).keeping(&sums, pixels, kept_bytes);
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
        let by_query = Side::new(scores, Queries::InColumns);
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
        let side = Side::new(Pairs::new(isa, precision, keys, queries, pixels), Queries::InRows);
        side.keeping(&self.sums, pixels, self.kept_bytes)
    }

    /// The weights of the block's pixels and a group's, and the number of elements from one panel to the next: kept, or else
    /// computed into the scratch buffer.
    fn of_block<'a>(
        &self,
        side: &'a Side,
        group: Group,
        block: (usize, usize),
        scratch: &'a mut [f32],
    ) -> (Right<'a>, usize) {
        if let Some(kept) = side.of_kept(self.pixels, group, block) {
            return kept;
        }
        let step = BLOCK * panel_columns(self.isa);
        side.compute(&self.sums, group, block, scratch, step);
        (Right::F32(scratch), step)
    }

    /// [`Self::of_block`] with the queries in columns, in `f32`: pairs that are kept are not used.
    pub(super) fn of_queries<'a>(
        &'a self,
        group: Group,
        block: (usize, usize),
        scratch: &'a mut [f32],
    ) -> (&'a [f32], usize) {
        let side = &self.by_query;
        if let Some((Right::F32(kept), step)) = side.of_kept(self.pixels, group, block) {
            return (kept, step);
        }
        let step = BLOCK * panel_columns(self.isa);
        side.compute(&self.sums, group, block, scratch, step);
        (scratch, step)
    }

    fn gather_from(&self, side: &Side, values: &[f32]) -> Vec<f32> {
        let Self { isa, precision, pixels, .. } = *self;
        assert!(values.len().is_multiple_of(pixels), "values of {pixels} pixels");
        let values = ChannelsAsRows::new(isa, precision, values, pixels, BLOCK);
        let gathering = Gathering { isa, values: &values };
        let width = panel_columns(isa);
        let sizes = [1, values.channels, pixels];
        let scratch = || Scratch::of(PANELS * BLOCK * width);
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
        let of = |side: &Side| match &side.kept {
            Kept::F32(kept) => size_of_val(&kept[..]),
            Kept::Bf16(kept) => size_of_val(&kept[..]),
        };
        of(&self.by_query) + self.by_key.get().map_or(0, of)
    }
}

impl Side {
    /// Nothing of it is kept.
    fn new(scores: Pairs, queries: Queries) -> Self {
        Self { scores, queries, kept: Kept::F32(Vec::new()), kept_panels: 0 }
    }

    /// Keeps what fits in `kept_bytes`.
    fn keeping(mut self, sums: &Sums, pixels: usize, kept_bytes: usize) -> Self {
        let (isa, precision) = (self.scores.isa, self.scores.rows.precision());
        let width = panel_columns(isa);
        let step = panel_len(isa, precision, pixels);
        let panels = panels_within(isa, precision, pixels, kept_bytes);
        let group_len = (PANELS * step).max(1);
        self.kept = match precision {
            Precision::F32 => {
                let mut kept = vec![0.0; panels * step];
                kept.par_chunks_mut(group_len).enumerate().for_each(|(number, kept)| {
                    let group = Group::of(isa, number, pixels);
                    for block @ (first, _) in blocks(pixels) {
                        self.compute(sums, group, block, &mut kept[first * width..], step);
                    }
                });
                Kept::F32(kept)
            }
            Precision::Bf16 => {
                let mut kept = vec![Pair::default(); panels * step];
                let scratch = || Scratch::of(PANELS * BLOCK * width);
                let groups = kept.par_chunks_mut(group_len).enumerate();
                groups.for_each_init(scratch, |scratch, (number, kept)| {
                    let group = Group::of(isa, number, pixels);
                    for block @ (first, len) in blocks(pixels) {
                        self.compute(sums, group, block, scratch, BLOCK * width);
                        let at = precision.packed(first) * width;
                        let panels = scratch.chunks_exact(BLOCK * width).zip(kept.chunks_exact_mut(step));
                        for (weights, kept) in panels {
                            pair_rows(isa, &weights[..len * width], width, &mut kept[at..]);
                        }
                    }
                });
                Kept::Bf16(kept)
            }
        };
        self.kept_panels = panels;
        self
    }

    /// The kept weights of the block's pixels and a group's, and the number of elements from one panel to the next.
    fn of_kept(&self, pixels: usize, group: Group, (first, _): (usize, usize)) -> Option<(Right<'_>, usize)> {
        if group.first >= self.kept_panels {
            return None;
        }
        let (isa, precision) = (self.scores.isa, self.scores.rows.precision());
        let step = panel_len(isa, precision, pixels);
        let at = group.first * step + precision.packed(first) * panel_columns(isa);
        let kept = match &self.kept {
            Kept::F32(kept) => Right::F32(&kept[at..]),
            Kept::Bf16(kept) => Right::Bf16(&kept[at..]),
        };
        Some((kept, step))
    }

    /// Computes the weights of the block's pixels and a group's: `[block, columns]`, panel after panel, `step` elements apart.
    fn compute(&self, sums: &Sums, group: Group, block: (usize, usize), out: &mut [f32], step: usize) {
        let isa = self.scores.isa;
        let width = panel_columns(isa);
        let mut output = Output::new(out, Steps { row: width, panel: step });
        self.scores.multiply(group, block, Start::Zero, &mut output);
        for panel in 0..group.panels {
            let normal = sums.of(self.queries, group, block, panel, width);
            weigh(isa, &mut out[panel * step..][..block.1 * width], width, normal);
        }
    }
}
