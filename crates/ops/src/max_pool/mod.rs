//! Max pooling over 2x2 pixels, without the indices that Burn stores for the backward pass. [`mod@reference`] is the definition.

use rayon::prelude::*;

use crate::MapShape;

mod composed;
pub mod reference;
pub mod tensor;

/// The output's size.
fn pooled(size: MapShape) -> MapShape {
    MapShape { height: size.height / 2, width: size.width / 2, ..size }
}

/// The largest of each 2x2 pixels, `[batch, channels, height / 2, width / 2]`; NaN where one is NaN. `size` is the input's; a
/// last odd row or column is left out. Panics when the slice does not fit the size.
pub fn max_pool(input: &[f32], size: MapShape) -> Vec<f32> {
    assert_eq!(input.len(), size.elements(), "input of {size:?}");
    let mut out = vec![0.0; pooled(size).elements()];
    if out.is_empty() {
        return out;
    }
    let planes = out.par_chunks_mut(pooled(size).pixels()).zip(input.par_chunks(size.pixels()));
    planes.for_each(|(out, plane)| {
        let rows = out.chunks_exact_mut(size.width / 2).zip(plane.chunks_exact(2 * size.width));
        for (out, rows) in rows {
            let (upper, lower) = rows.split_at(size.width);
            let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
            for (out, (upper, lower)) in out.iter_mut().zip(pairs) {
                *out = larger(larger(upper[0], upper[1]), larger(lower[0], lower[1]));
            }
        }
    });
    out
}

/// Gradient of the input, given `grad`, that of the output: each goes to the first of the largest pixels. Panics when the length
/// of a slice does not match the size.
pub fn max_pool_backward(input: &[f32], grad: &[f32], size: MapShape) -> Vec<f32> {
    assert_eq!(input.len(), size.elements(), "input of {size:?}");
    assert_eq!(grad.len(), pooled(size).elements(), "gradient of {size:?}");
    let mut out = vec![0.0; input.len()];
    if grad.is_empty() {
        return out;
    }
    let planes = input.par_chunks(size.pixels()).zip(grad.par_chunks(pooled(size).pixels()));
    out.par_chunks_mut(size.pixels()).zip(planes).for_each(|(out, (plane, grad))| {
        let rows = out.chunks_exact_mut(2 * size.width).zip(plane.chunks_exact(2 * size.width));
        for ((out, rows), grad) in rows.zip(grad.chunks_exact(size.width / 2)) {
            let (upper, lower) = rows.split_at(size.width);
            let (out_upper, out_lower) = out.split_at_mut(size.width);
            let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
            let outs = out_upper.chunks_exact_mut(2).zip(out_lower.chunks_exact_mut(2));
            for ((&grad, (upper, lower)), (out_upper, out_lower)) in grad.iter().zip(pairs).zip(outs) {
                // A row's second pixel and the lower row win only if they are larger: the first of equal ones wins.
                let below = wins(larger(lower[0], lower[1]), larger(upper[0], upper[1]));
                let (right_above, right_below) = (wins(upper[1], upper[0]), wins(lower[1], lower[0]));
                let given = |chosen: bool| if chosen { grad } else { 0.0 };
                out_upper[0] = given(!below & !right_above);
                out_upper[1] = given(!below & right_above);
                out_lower[0] = given(below & !right_below);
                out_lower[1] = given(below & right_below);
            }
        }
    });
    out
}

/// Whether `second` wins over `first`, which precedes it.
fn wins(second: f32, first: f32) -> bool {
    (second > first) | (second.is_nan() & !first.is_nan())
}

fn larger(first: f32, second: f32) -> f32 {
    if wins(second, first) { second } else { first }
}

#[cfg(test)]
pub(crate) mod tests;
