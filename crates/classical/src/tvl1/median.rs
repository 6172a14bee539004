//! Median filter of the flow, 3 or 5 pixels a side, by networks of minima and maxima on whole vectors.

use rayon::prelude::*;

use super::state::{MARGIN, State, rows_per_task, value_line};
use crate::block::block;
use srflow_simd::multiversioned;

/// Pixels that are filtered together.
const BLOCK: usize = 16;

/// One window position for a block of pixels.
type Lanes = [f32; BLOCK];

/// Sets `filtered` to `state` with `u` and `v` replaced by their medians over `side` x `side` pixels. Outside the image the
/// border pixels are repeated.
pub fn filter(filtered: &mut State, state: &State, side: usize) {
    let layout = state.layout;
    let radius = side / 2;
    let lines = filtered.rows.par_chunks_exact_mut(layout.unknowns()).enumerate();
    lines.with_min_len(rows_per_task(layout.width)).for_each_init(
        || vec![vec![0.0; (layout.width + 2 * radius).next_multiple_of(BLOCK) + BLOCK]; side],
        |window, (y, out)| {
            out.copy_from_slice(state.row(y));
            for component in 0..2 {
                for (i, line) in window.iter_mut().enumerate() {
                    let row = (y + i).saturating_sub(radius).min(layout.height - 1);
                    pad(line, state.values(row, component), radius);
                }
                let start = value_line(component) * layout.stride + MARGIN;
                let out = &mut out[start..start + layout.width];
                match window.as_mut_slice() {
                    [a, b, c] => median_of_3_rows(out, a, b, c),
                    [a, b, c, d, e] => median_of_5_rows(out, a, b, c, d, e),
                    _ => {}
                }
            }
        },
    );
}

fn pad(line: &mut [f32], values: &[f32], radius: usize) {
    let width = values.len();
    line[..radius].fill(values[0]);
    line[radius..radius + width].copy_from_slice(values);
    line[radius + width..].fill(values[width - 1]);
}

multiversioned! {
    fn median_of_3_rows(out: &mut [f32], a: &mut [f32], b: &mut [f32], c: &mut [f32]) {
        sort_columns_3(a, b, c);
        for (number, out) in out.chunks_mut(BLOCK).enumerate() {
            let columns = |line: &[f32]| [0, 1, 2].map(|column| block(line, number * BLOCK + column));
            let ([mut low0, mut low1, low2], [mut mid0, mut mid1, mut mid2]) = (columns(a), columns(b));
            let [mut high0, mut high1, high2] = columns(c);
            // The largest of the smallest, the middle one of the middle ones, the smallest of the largest.
            order(&mut low0, &mut low1);
            let mut low = larger(&low1, &low2);
            sort_3(&mut mid0, &mut mid1, &mut mid2);
            order(&mut high0, &mut high1);
            let mut high = smaller(&high0, &high2);
            sort_3(&mut low, &mut mid1, &mut high);
            out.copy_from_slice(&mid1[..out.len()]);
        }
    }
}

multiversioned! {
    fn median_of_5_rows(out: &mut [f32], a: &mut [f32], b: &mut [f32], c: &mut [f32], d: &mut [f32], e: &mut [f32]) {
        sort_columns_5(a, b, c, d, e);
        for (number, out) in out.chunks_mut(BLOCK).enumerate() {
            let columns = |line: &[f32]| [0, 1, 2, 3, 4].map(|column| block(line, number * BLOCK + column));
            // With columns and then rows sorted, a value with 13 or more values on one side of it is not the median. That leaves 13
            // of the 25, and the median is theirs.
            let [_, _, _, a3, a4] = sort_5(columns(a));
            let [_, _, b2, b3, b4] = sort_5(columns(b));
            let [_, c1, c2, c3, _] = sort_5(columns(c));
            let [d0, d1, d2, _, _] = sort_5(columns(d));
            let [e0, e1, _, _, _] = sort_5(columns(e));
            let median = median_of_13([a3, a4, b2, b3, b4, c1, c2, c3, d0, d1, d2, e0, e1]);
            out.copy_from_slice(&median[..out.len()]);
        }
    }
}

/// Removes the extremes until one value is left: of 8 of the 13 values, neither the smallest nor the largest can be the
/// median; add one value, and the same holds for the remaining 7; and so on.
#[inline(always)]
fn median_of_13(values: [Lanes; 13]) -> Lanes {
    let [v0, v1, v2, v3, v4, v5, v6, v7, v8, v9, v10, v11, v12] = values;
    let [_, m1, m2, m3, m4, m5, m6, _] = extremes_outside([v0, v1, v2, v3, v4, v5, v6, v7]);
    let [_, m1, m2, m3, m4, m5, _] = extremes_outside([m1, m2, m3, m4, m5, m6, v8]);
    let [_, m1, m2, m3, m4, _] = extremes_outside([m1, m2, m3, m4, m5, v9]);
    let [_, m1, m2, m3, _] = extremes_outside([m1, m2, m3, m4, v10]);
    let [_, m1, m2, _] = extremes_outside([m1, m2, m3, v11]);
    let [_, median, _] = extremes_outside([m1, m2, v12]);
    median
}

/// Moves the smallest value to the front and the largest to the back.
#[inline(always)]
fn extremes_outside<const N: usize>(mut values: [Lanes; N]) -> [Lanes; N] {
    for i in 0..N / 2 {
        order_two(&mut values, i, N - 1 - i);
    }
    // Now the smallest is in the front half and the largest in the back half; an odd one is in both.
    for i in 1..N.div_ceil(2) {
        order_two(&mut values, 0, i);
    }
    for i in N / 2..N - 1 {
        order_two(&mut values, i, N - 1);
    }
    values
}

// Not a closure: those are not always inlined, and then have no vector instructions.
#[inline(always)]
fn order_two(values: &mut [Lanes], low: usize, high: usize) {
    let (head, tail) = values.split_at_mut(high);
    order(&mut head[low], &mut tail[0]);
}

#[inline(always)]
fn sort_5([mut a, mut b, mut c, mut d, mut e]: [Lanes; 5]) -> [Lanes; 5] {
    order(&mut a, &mut b);
    order(&mut d, &mut e);
    order(&mut c, &mut e);
    order(&mut c, &mut d);
    order(&mut b, &mut e);
    order(&mut a, &mut d);
    order(&mut a, &mut c);
    order(&mut b, &mut d);
    order(&mut b, &mut c);
    [a, b, c, d, e]
}

#[inline(always)]
fn sort_3(a: &mut Lanes, b: &mut Lanes, c: &mut Lanes) {
    order(a, b);
    order(b, c);
    order(a, b);
}

#[inline(always)]
fn sort_columns_5(a: &mut [f32], b: &mut [f32], c: &mut [f32], d: &mut [f32], e: &mut [f32]) {
    for start in (0..a.len()).step_by(BLOCK) {
        let sorted =
            sort_5([block(a, start), block(b, start), block(c, start), block(d, start), block(e, start)]);
        for (line, values) in [&mut *a, b, c, d, e].into_iter().zip(&sorted) {
            line[start..start + BLOCK].copy_from_slice(values);
        }
    }
}

#[inline(always)]
fn sort_columns_3(a: &mut [f32], b: &mut [f32], c: &mut [f32]) {
    for start in (0..a.len()).step_by(BLOCK) {
        let [mut low, mut mid, mut high] = [block(a, start), block(b, start), block(c, start)];
        sort_3(&mut low, &mut mid, &mut high);
        for (line, values) in [&mut *a, b, c].into_iter().zip([low, mid, high]) {
            line[start..start + BLOCK].copy_from_slice(&values);
        }
    }
}

/// Swaps the lanes where `a` is larger than `b`.
#[inline(always)]
fn order(a: &mut Lanes, b: &mut Lanes) {
    (*a, *b) = (smaller(a, b), larger(a, b));
}

#[inline(always)]
fn smaller(a: &Lanes, b: &Lanes) -> Lanes {
    std::array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
}

#[inline(always)]
fn larger(a: &Lanes, b: &Lanes) -> Lanes {
    std::array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
}
