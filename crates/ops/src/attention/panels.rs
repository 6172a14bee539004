//! Memory layout of attention's operands, and the split of the work into pieces.

use rayon::prelude::*;
use srflow_simd::{Isa, Left, Packed, Precision, panel_columns};

/// Panels of pixels in one piece of work.
pub(super) const PANELS: usize = 4;
/// Pixels in a block; a multiple of every register tile.
pub(super) const BLOCK: usize = 256;

/// Reorders `[rows, pixels]` into panels `[rows, columns]`, zero-padding the last panel.
pub(super) fn to_panels(isa: Isa, matrix: &[f32], pixels: usize) -> Vec<f32> {
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

/// What [`to_panels`] reordered, as `[rows, pixels]` again.
pub(super) fn from_panels(isa: Isa, panels: &[f32], pixels: usize) -> Vec<f32> {
    let width = panel_columns(isa);
    let rows = panels.len() / pixels.next_multiple_of(width);
    let mut matrix = vec![0.0; rows * pixels];
    matrix.par_chunks_mut(pixels).enumerate().for_each(|(row, to)| {
        for (to, panel) in to.chunks_mut(width).zip(panels.chunks_exact(rows * width)) {
            to.copy_from_slice(&panel[row * width..][..to.len()]);
        }
    });
    matrix
}

/// `[channels, pixels]` as left sides with one row per channel, one side for each block of pixels.
#[derive(Debug)]
pub(super) struct ChannelsAsRows {
    pub(super) channels: usize,
    block: usize,
    packed: Packed,
}

impl ChannelsAsRows {
    pub(super) fn new(isa: Isa, precision: Precision, matrix: &[f32], pixels: usize, block: usize) -> Self {
        let channels = matrix.len() / pixels;
        let depths: Vec<usize> = (0..pixels).step_by(block).map(|first| block.min(pixels - first)).collect();
        let packed = Packed::parts(isa, precision, channels, &depths, |number, rows| {
            for (to, plane) in rows.chunks_exact_mut(depths[number]).zip(matrix.chunks_exact(pixels)) {
                to.copy_from_slice(&plane[number * block..][..to.len()]);
            }
        });
        Self { channels, block, packed }
    }

    /// The block that begins with a pixel.
    pub(super) fn block_at(&self, first: usize) -> Left<'_> {
        self.packed.part(first / self.block)
    }
}

/// The columns of panels from `first` on, at most [`PANELS`] of them.
#[derive(Clone, Copy)]
pub(super) struct Group {
    pub(super) first: usize,
    pub(super) panels: usize,
    pub(super) columns: usize,
}

impl Group {
    pub(super) fn of(isa: Isa, number: usize, pixels: usize) -> Self {
        let width = panel_columns(isa);
        let first = number * PANELS;
        let columns = (PANELS * width).min(pixels - first * width);
        Self { first, panels: columns.div_ceil(width), columns }
    }

    pub(super) fn count(isa: Isa, pixels: usize) -> usize {
        pixels.div_ceil(PANELS * panel_columns(isa))
    }
}

/// Blocks of `pixels`: first pixel and length.
pub(super) fn blocks(pixels: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..pixels).step_by(BLOCK).map(move |first| (first, BLOCK.min(pixels - first)))
}
