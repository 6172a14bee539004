//! The pixels of square blocks as channels: PyTorch's `pixel_unshuffle`. [`mod@reference`] is the definition.

use rayon::prelude::*;
use srflow_simd::zeros;

use crate::MapShape;

mod composed;
pub mod reference;
pub mod tensor;

/// The output's size. Panics when the blocks do not fill the maps.
fn in_blocks(shape: MapShape, side: usize) -> MapShape {
    let MapShape { batch, channels, height, width } = shape;
    assert_eq!([height % side, width % side], [0, 0], "whole blocks of {side}x{side} in {shape:?}");
    MapShape { batch, channels: channels * side * side, height: height / side, width: width / side }
}

/// `input`, maps of `shape`, with the pixels of each block of `side` x `side`, row by row, as channels:
/// `[batch, channels * side^2, height / side, width / side]`. Panics when the sizes do not fit.
pub fn space_to_depth(input: &[f32], shape: MapShape, side: usize) -> Vec<f32> {
    assert_eq!(input.len(), shape.elements(), "input of {shape:?}");
    let mut out = zeros(input.len());
    if out.is_empty() {
        return out;
    }
    let MapShape { channels, height, width, .. } = in_blocks(shape, side);
    out.par_chunks_mut(width).enumerate().for_each(|(row, out)| {
        let (plane, y) = (row / height, row % height);
        let (n, channel) = (plane / channels, plane % channels);
        let (channel, place) = (channel / (side * side), channel % (side * side));
        let from = ((n * shape.channels + channel) * shape.height + y * side + place / side) * shape.width;
        let from = &input[from..][..shape.width];
        for (to, from) in out.iter_mut().zip(from[place % side..].iter().step_by(side)) {
            *to = *from;
        }
    });
    out
}

/// The inverse of [`space_to_depth`], which is its gradient: maps of `shape` from those of their blocks. Panics when the sizes do not
/// fit.
pub fn depth_to_space(blocks: &[f32], shape: MapShape, side: usize) -> Vec<f32> {
    assert_eq!(blocks.len(), shape.elements(), "blocks of {shape:?}");
    let mut out = vec![0.0; blocks.len()];
    if out.is_empty() {
        return out;
    }
    let MapShape { channels, height, width, .. } = in_blocks(shape, side);
    out.par_chunks_mut(shape.width).enumerate().for_each(|(row, out)| {
        let (plane, y) = (row / shape.height, row % shape.height);
        let (n, channel) = (plane / shape.channels, plane % shape.channels);
        for column in 0..side {
            let place = (y % side) * side + column;
            let from = ((n * channels + channel * side * side + place) * height + y / side) * width;
            for (to, from) in out[column..].iter_mut().step_by(side).zip(&blocks[from..][..width]) {
                *to = *from;
            }
        }
    });
    out
}

#[cfg(test)]
pub(crate) mod tests;
