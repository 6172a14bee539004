//! The definition: PyTorch's `interpolate(x, size, mode="bilinear")`, for each alignment of the grids.

use super::Grids;
use crate::MapShape;

/// The four input pixels that make an output pixel, with their weights.
fn corners([y, x]: [usize; 2], shape: MapShape, size: [usize; 2], grids: Grids) -> [(usize, f64); 4] {
    let along = |i: usize, from: usize, size: usize| {
        let place = grids.place(i, from, size);
        let first = place.floor() as usize;
        let fraction = place - place.floor();
        [(first, 1.0 - fraction), ((first + 1).min(from - 1), fraction)]
    };
    let [upper, lower] = along(y, shape.height, size[0]);
    let [left, right] = along(x, shape.width, size[1]);
    [(upper, left), (upper, right), (lower, left), (lower, right)]
        .map(|((row, above), (column, beside))| (row * shape.width + column, above * beside))
}

/// Every output pixel of every plane: its index, and those of the input pixels that make it, with their weights.
fn all(shape: MapShape, size: [usize; 2], grids: Grids) -> Vec<(usize, [(usize, f64); 4])> {
    let mut all = Vec::new();
    for plane in 0..shape.planes() {
        for (y, x) in (0..size[0]).flat_map(|y| (0..size[1]).map(move |x| (y, x))) {
            let from = corners([y, x], shape, size, grids);
            all.push((all.len(), from.map(|(pixel, weight)| (plane * shape.pixels() + pixel, weight))));
        }
    }
    all
}

/// See [`super::resize`].
pub fn resize(input: &[f64], shape: MapShape, size: [usize; 2], grids: Grids) -> Vec<f64> {
    let value = |from: [(usize, f64); 4]| from.iter().map(|(pixel, weight)| input[*pixel] * weight).sum();
    all(shape, size, grids).into_iter().map(|(_, from)| value(from)).collect()
}

/// See [`super::resize_backward`].
pub fn resize_backward(grad: &[f64], shape: MapShape, size: [usize; 2], grids: Grids) -> Vec<f64> {
    let mut out = vec![0.0; shape.elements()];
    for (to, from) in all(shape, size, grids) {
        from.iter().for_each(|(pixel, weight)| out[*pixel] += grad[to] * weight);
    }
    out
}
