//! The definition: PyTorch's `pixel_unshuffle`.

use super::in_blocks;
use crate::MapShape;

/// The index in the input of each element of the output.
fn sources(shape: MapShape, side: usize) -> Vec<usize> {
    let blocks = in_blocks(shape, side);
    let mut found = Vec::new();
    for (n, c) in (0..shape.batch).flat_map(|n| (0..shape.channels).map(move |c| (n, c))) {
        for (row, column) in (0..side).flat_map(|row| (0..side).map(move |column| (row, column))) {
            for (y, x) in (0..blocks.height).flat_map(|y| (0..blocks.width).map(move |x| (y, x))) {
                let (y, x) = (side * y + row, side * x + column);
                found.push(((n * shape.channels + c) * shape.height + y) * shape.width + x);
            }
        }
    }
    found
}

/// See [`super::space_to_depth`].
pub fn space_to_depth(input: &[f64], shape: MapShape, side: usize) -> Vec<f64> {
    sources(shape, side).into_iter().map(|source| input[source]).collect()
}

/// See [`super::depth_to_space`].
pub fn depth_to_space(blocks: &[f64], shape: MapShape, side: usize) -> Vec<f64> {
    let mut out = vec![0.0; blocks.len()];
    sources(shape, side).into_iter().zip(blocks).for_each(|(source, value)| out[source] = *value);
    out
}
