//! Attention that concentrates on few pixels: blocks of keys whose weights are small are not multiplied with values.

use std::cell::Cell;

use rayon::prelude::*;
use srflow_simd::{Scratch, multiversioned, panel_columns};

use super::panels::{BLOCK, Group, PANELS, blocks};
use super::weights::AttentionWeights;
use crate::scoped;

/// Rows of a strip of an image, of which a block takes as many columns.
const STRIP: usize = BLOCK.isqrt();

thread_local! {
    static TOLERANCE: Cell<f32> = const { Cell::new(0.0) };
}

/// Calls `of` with [`super::tensor::Attention`] leaving out pixels in this thread: of the weights of each pixel, which sum to one, those
/// that are left out sum to no more than `tolerance`. So what a pixel gathers is wrong by no more than `tolerance` times the largest
/// value. Nothing is left out at zero, with gradients, and on other devices than the CPU.
pub fn with_attention_tolerance<T>(tolerance: f32, of: impl FnOnce() -> T) -> T {
    scoped::with(&TOLERANCE, tolerance, of)
}

/// The tolerance of this thread: zero outside of [`with_attention_tolerance`].
pub(super) fn attention_tolerance() -> f32 {
    TOLERANCE.get()
}

/// The pixels of an image in strips of rows, column by column in each: those of a block are near each other in both directions, as
/// pixels that attend to each other are.
#[derive(Debug)]
pub(super) struct StripOrder {
    /// Number in the image of each.
    pixels: Vec<usize>,
}

impl StripOrder {
    pub(super) fn of([height, width]: [usize; 2]) -> Self {
        let strip = |top: usize| {
            let rows = top..(top + STRIP).min(height);
            (0..width).flat_map(move |x| rows.clone().map(move |y| y * width + x))
        };
        Self { pixels: (0..height).step_by(STRIP).flat_map(strip).collect() }
    }

    /// `[channels, pixels]` in this order.
    pub(super) fn ordered(&self, image: &[f32]) -> Vec<f32> {
        self.moved(image, |plane, ordered| {
            ordered.iter_mut().zip(&self.pixels).for_each(|(to, &pixel)| *to = plane[pixel]);
        })
    }

    /// Back from [`Self::ordered`].
    pub(super) fn restored(&self, ordered: &[f32]) -> Vec<f32> {
        self.moved(ordered, |plane, image| {
            plane.iter().zip(&self.pixels).for_each(|(from, &pixel)| image[pixel] = *from);
        })
    }

    fn moved(&self, planes: &[f32], plane: impl Fn(&[f32], &mut [f32]) + Sync) -> Vec<f32> {
        let pixels = self.pixels.len();
        let mut moved = vec![0.0; planes.len()];
        let pairs = planes.par_chunks_exact(pixels).zip(moved.par_chunks_exact_mut(pixels));
        pairs.for_each(|(from, to)| plane(from, to));
        moved
    }
}

multiversioned! {
    /// Adds the sum of each column of `rows`, which are as wide as there are sums.
    fn add_rows(rows: &[f32], sums: &mut [f32]) {
        for row in rows.chunks_exact(sums.len()) {
            sums.iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
        }
    }
}

impl AttentionWeights {
    /// The same, gathering only from blocks of keys that matter: for each query the weights of the other blocks sum to no more than
    /// `tolerance`. Gradients are of all.
    pub(crate) fn within(mut self, tolerance: f32) -> Self {
        let (isa, pixels) = (self.isa, self.pixels);
        let width = panel_columns(isa);
        let gathered = (0..Group::count(isa, pixels)).into_par_iter().map_init(
            || Scratch::of(PANELS * BLOCK * width),
            |scratch, number| {
                let group = Group::of(isa, number, pixels);
                let mut of_blocks = vec![0.0; pixels.div_ceil(BLOCK) * PANELS * width];
                let sums = of_blocks.chunks_exact_mut(PANELS * width);
                for (block, sums) in blocks(pixels).zip(sums) {
                    let (weights, step) = self.of_queries(group, block, scratch);
                    for (panel, sums) in sums.chunks_exact_mut(width).take(group.panels).enumerate() {
                        add_rows(&weights[panel * step..][..block.1 * width], sums);
                    }
                }
                let of_blocks: Vec<&[f32]> =
                    of_blocks.chunks_exact(PANELS * width).map(|sums| &sums[..group.columns]).collect();
                let gathered = that_matter(&of_blocks, tolerance);
                blocks(pixels)
                    .zip(gathered)
                    .filter_map(|(block, gathered)| gathered.then_some(block))
                    .collect()
            },
        );
        self.gathered = Some(gathered.collect());
        self
    }
}

/// Which blocks are to be gathered from, given the sum of the weights of each query in each. The first always is, since it starts the
/// sums. Those of the smallest weights are left out first; what is not a number is not left out.
fn that_matter(of_blocks: &[&[f32]], tolerance: f32) -> Vec<bool> {
    let largest = |block: &[f32]| block.iter().copied().fold(0.0, f32::max);
    let mut order: Vec<usize> = (1..of_blocks.len()).collect();
    order.sort_by(|&a, &b| largest(of_blocks[a]).total_cmp(&largest(of_blocks[b])));
    let mut left_out = vec![0.0; of_blocks.first().map_or(0, |block| block.len())];
    let mut matter = vec![true; of_blocks.len()];
    for block in order {
        let with_it: Vec<f32> = left_out.iter().zip(of_blocks[block]).map(|(sum, more)| sum + more).collect();
        if with_it.iter().all(|&sum| sum <= tolerance) {
            left_out = with_it;
            matter[block] = false;
        }
    }
    matter
}
