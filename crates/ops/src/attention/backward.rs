//! Gradients of queries and keys.
//!
//! With weights `w_ij`, the gradient `g_i` of the output of pixel `i`, values `v_j`, and the gradient `l_i` of the logarithm of
//! the sum of pixel `i`, the gradient of the score of `i` and `j` is `w_ij (g_i . v_j - g_i . out_i + l_i)`. Several outputs with
//! the same weights differ only in `g` and `v`: the sum of their products is formed block by block, so one pass serves all of
//! them and no gradient of the weights is stored. Queries and keys need the gradients of scores summed along different
//! sides; so a strip of them (some queries, all keys) is stored, used for both, and replaced by the next.

use rayon::prelude::*;
use srflow_simd::{Output, Right, Scratch, SharedMut, Start, Steps, panel_columns};

use super::AttentionWeights;
use super::panels::{BLOCK, ChannelsAsRows, Group, PANELS, blocks};
use super::softmax::to_score_gradients;
use super::weights::{Gathering, Pairs};

/// Size of the strip of score gradients. The results do not depend on it.
const STRIP_BYTES: usize = 32 << 20;

/// Values, the outputs computed from them, and the gradient of those, each `[channels, pixels]`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gathered<'a> {
    pub(crate) values: &'a [f32],
    pub(crate) gathered: &'a [f32],
    pub(crate) grad: &'a [f32],
}

impl AttentionWeights {
    /// Gradients of queries and keys from all outputs computed with these weights, and from the gradient of
    /// [`Self::log_sums`].
    pub(crate) fn backward(
        &self,
        queries: &[f32],
        keys: &[f32],
        gathered: &[Gathered],
        of_log_sums: &[f32],
    ) -> [Vec<f32>; 2] {
        self.backward_in_strips(queries, keys, gathered, of_log_sums, STRIP_BYTES)
    }

    pub(super) fn backward_in_strips(
        &self,
        queries: &[f32],
        keys: &[f32],
        gathered: &[Gathered],
        of_log_sums: &[f32],
        strip_bytes: usize,
    ) -> [Vec<f32>; 2] {
        let Self { isa, precision, pixels, .. } = *self;
        let width = panel_columns(isa);
        let (mut d_queries, mut d_keys) = (vec![0.0; queries.len()], vec![0.0; keys.len()]);
        if gathered.is_empty() && of_log_sums.iter().all(|&gradient| gradient == 0.0) {
            return [d_queries, d_keys];
        }
        let products: Vec<Pairs> =
            gathered.iter().map(|of| Pairs::new(isa, precision, of.grad, of.values, pixels)).collect();
        let means = self.mean_gradients(gathered, of_log_sums);
        let packed_keys = ChannelsAsRows::new(isa, precision, keys, pixels, BLOCK);
        // A group of queries is one block for the keys.
        let packed_queries = ChannelsAsRows::new(isa, precision, queries, pixels, PANELS * width);

        let steps = Steps { row: pixels, panel: width };
        let groups = Group::count(isa, pixels);
        let group_len = PANELS * width * pixels;
        let strip_groups = (strip_bytes / size_of::<f32>() / group_len).clamp(1, groups);
        let mut strip = vec![0.0; strip_groups * group_len];
        for first_group in (0..groups).step_by(strip_groups) {
            let strip_groups = strip_groups.min(groups - first_group);
            let of_queries = Gathering { isa, values: &packed_keys };
            let out = SharedMut::new(&mut d_queries);
            strip.par_chunks_mut(group_len).take(strip_groups).enumerate().for_each_init(
                || Scratch::of(PANELS * BLOCK * width),
                |scratch, (number, gradients)| {
                    let group = Group::of(isa, first_group + number, pixels);
                    // SAFETY: the group's pixels are this task's.
                    let mut out = unsafe { out.output(group.first * width, steps) };
                    for block @ (first, _) in blocks(pixels) {
                        let gradients = &mut gradients[first * width..];
                        self.score_gradients(&products, &means, group, block, gradients, scratch);
                        of_queries.add(group, block, Right::F32(gradients), pixels * width, &mut out);
                    }
                },
            );
            let of_keys = Gathering { isa, values: &packed_queries };
            let out = SharedMut::new(&mut d_keys);
            (0..groups).into_par_iter().for_each_init(
                || Scratch::of(PANELS * width * PANELS * width),
                |transposed, number| {
                    let group = Group::of(isa, number, pixels);
                    // SAFETY: the group's pixels are this task's.
                    let mut out = unsafe { out.output(group.first * width, steps) };
                    for (number, gradients) in strip.chunks_exact(group_len).take(strip_groups).enumerate() {
                        let from = Group::of(isa, first_group + number, pixels);
                        transpose(gradients, pixels, from, group, width, transposed);
                        let block = (from.first * width, from.columns);
                        of_keys.add(group, block, Right::F32(transposed), PANELS * width * width, &mut out);
                    }
                },
            );
        }
        [d_queries, d_keys]
    }

    /// `g_i . out_i` for each query, summed over all outputs, minus `l_i`; zero in the padding of the last panel.
    fn mean_gradients(&self, gathered: &[Gathered], of_log_sums: &[f32]) -> Vec<f32> {
        let width = panel_columns(self.isa);
        let mut means: Vec<f32> = of_log_sums.iter().map(|gradient| -gradient).collect();
        means.resize(self.pixels.div_ceil(width) * width, 0.0);
        means.par_chunks_mut(PANELS * width).enumerate().for_each(|(number, means)| {
            let group = Group::of(self.isa, number, self.pixels);
            let pixels = group.first * width..group.first * width + group.columns;
            for of in gathered {
                let planes = of.grad.chunks_exact(self.pixels).zip(of.gathered.chunks_exact(self.pixels));
                for (grad, gathered) in planes {
                    let pairs = grad[pixels.clone()].iter().zip(&gathered[pixels.clone()]);
                    for (mean, (grad, gathered)) in means.iter_mut().zip(pairs) {
                        *mean = grad.mul_add(*gathered, *mean);
                    }
                }
            }
        });
        means
    }

    /// Gradients of the scores between the block's pixels and a group's: `[block, columns]` at the start of `out`, in the panel
    /// layout of the kept weights.
    fn score_gradients(
        &self,
        products: &[Pairs],
        means: &[f32],
        group: Group,
        block: (usize, usize),
        out: &mut [f32],
        scratch: &mut [f32],
    ) {
        let width = panel_columns(self.isa);
        let panel_len = self.pixels * width;
        let (weights, step) = self.of_queries(group, block, scratch);
        if products.is_empty() {
            for panel in 0..group.panels {
                out[panel * panel_len..][..block.1 * width].fill(0.0);
            }
        }
        let mut output = Output::new(out, Steps { row: width, panel: panel_len });
        for (number, products) in products.iter().enumerate() {
            let start = if number == 0 { Start::Zero } else { Start::Output };
            products.multiply(group, block, start, &mut output);
        }
        for panel in 0..group.panels {
            let means = &means[(group.first + panel) * width..][..width];
            let gradients = &mut out[panel * panel_len..][..block.1 * width];
            to_score_gradients(self.isa, gradients, &weights[panel * step..], means);
        }
    }
}

/// Transposes panels of the group `from`, each `[pixels, columns]`, into panels whose columns are the pixels of the group
/// `to`, each `[columns of from, columns]`.
fn transpose(panels: &[f32], pixels: usize, from: Group, to: Group, width: usize, transposed: &mut [f32]) {
    for (panel, transposed) in transposed.chunks_exact_mut(PANELS * width * width).take(to.panels).enumerate()
    {
        let first = (to.first + panel) * width;
        for column in 0..width.min(pixels - first) {
            for (number, rows) in transposed.chunks_exact_mut(width * width).take(from.panels).enumerate() {
                let values = &panels[(number * pixels + first + column) * width..][..width];
                for (row, &value) in rows.chunks_exact_mut(width).zip(values) {
                    row[column] = value;
                }
            }
        }
    }
}
