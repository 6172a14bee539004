//! Warping the second frame by the flow, and the residual around it to first order.

use rayon::prelude::*;
use srflow_core::{Plane, Size};

use super::state::{Linearized, MARGIN, State, rows_per_task};
use srflow_simd::multiversioned;

/// Zeros around the frame: the reach of the interpolation at the outermost positions.
const BORDER: usize = 4;

/// Pixels whose weights are computed together.
const BLOCK: usize = 16;

/// Numbers per pixel: the frame, its derivatives along x and y, and one unused.
const CHANNELS: usize = 4;

/// A frame and its derivatives, padded for interpolation; zero outside the frame.
pub struct Warper {
    width: usize,
    height: usize,
    /// Row-major with [`BORDER`] pixels around the frame, [`CHANNELS`] per pixel.
    pixels: Vec<f32>,
}

impl Warper {
    pub fn new(frame: &Plane) -> Self {
        let Size { width, height } = frame.size();
        let row_len = (width + 2 * BORDER) * CHANNELS;
        let mut pixels = vec![0.0; row_len * (height + 2 * BORDER)];
        let inside = &mut pixels[BORDER * row_len..(BORDER + height) * row_len];
        let lines = inside.par_chunks_exact_mut(row_len).enumerate();
        lines.with_min_len(rows_per_task(width)).for_each(|(y, out)| {
            let (above, below) = (frame.row(y.saturating_sub(1)), frame.row((y + 1).min(height - 1)));
            let row = frame.row(y);
            let (out, _) = out[BORDER * CHANNELS..].as_chunks_mut::<CHANNELS>();
            for x in 0..width {
                let along = 0.5 * (row[(x + 1).min(width - 1)] - row[x.saturating_sub(1)]);
                out[x] = [row[x], along, 0.5 * (below[x] - above[x]), 0.0];
            }
        });
        Self { width, height, pixels }
    }

    /// The residual between `first` and the frame warped by the flow of `state`, linear in the flow.
    pub fn linearize(&self, linearized: &mut Linearized, first: &Plane, state: &State) {
        let layout = linearized.layout;
        let lines = linearized.rows.par_chunks_exact_mut(layout.data()).enumerate();
        lines.with_min_len(rows_per_task(layout.width)).for_each(|(y, row)| {
            let (x_line, rest) = row.split_at_mut(layout.stride);
            let (y_line, rest) = rest.split_at_mut(layout.stride);
            let (constant, inverse_square) = rest.split_at_mut(layout.stride);
            let [x_line, y_line, constant, inverse_square] = [x_line, y_line, constant, inverse_square]
                .map(|line| &mut line[MARGIN..MARGIN + layout.width]);
            let (u, v) = (state.values(y, 0), state.values(y, 1));
            warp_row(x_line, y_line, constant, self, y, u, v);
            complete_row(x_line, y_line, constant, inverse_square, first.row(y), u, v);
        });
    }
}

multiversioned! {
    /// Interpolates the warped frame and its derivatives at row `y`.
    fn warp_row(x_line: &mut [f32], y_line: &mut [f32], value: &mut [f32], warper: &Warper, y: usize, u: &[f32], v: &[f32]) {
        let row_len = (warper.width + 2 * BORDER) * CHANNELS;
        for start in (0..value.len()).step_by(BLOCK) {
            let len = BLOCK.min(value.len() - start);
            let (mut at_x, mut at_y) = ([0.0; BLOCK], [0.0; BLOCK]);
            at_x[..len].copy_from_slice(&u[start..start + len]);
            at_y[..len].copy_from_slice(&v[start..start + len]);
            for i in 0..BLOCK {
                at_x[i] += (start + i) as f32;
                at_y[i] += y as f32;
            }
            let (left, across) = taps(at_x, warper.width);
            let (top, down) = taps(at_y, warper.height);
            for i in 0..len {
                let mut sums = [0.0_f32; 4 * CHANNELS];
                for (row, down) in down.iter().enumerate() {
                    let first = (top[i] as usize + row) * row_len + left[i] as usize * CHANNELS;
                    let pixels = &warper.pixels[first..first + 4 * CHANNELS];
                    for number in 0..4 * CHANNELS {
                        sums[number] += pixels[number] * (across[number / CHANNELS][i] * down[i]);
                    }
                }
                value[start + i] = sums[0] + sums[4] + sums[8] + sums[12];
                x_line[start + i] = sums[1] + sums[5] + sums[9] + sums[13];
                y_line[start + i] = sums[2] + sums[6] + sums[10] + sums[14];
            }
        }
    }
}

/// For each position along a side of so many pixels, where the four pixels around it begin in the padded frame, and their weights.
#[inline(always)]
fn taps(at: [f32; BLOCK], side: usize) -> ([i32; BLOCK], [[f32; BLOCK]; 4]) {
    let (mut first, mut weights) = ([0; BLOCK], [[0.0; BLOCK]; 4]);
    for i in 0..BLOCK {
        let low = at[i].floor();
        let [outer, near, far, last] = cubic_weights(at[i] - low);
        (weights[0][i], weights[1][i], weights[2][i], weights[3][i]) = (outer, near, far, last);
        // Farther out everything is zero.
        first[i] = low.clamp(-3.0, (side + 1) as f32) as i32 + 3;
    }
    (first, weights)
}

/// Weights of the four pixels around a position `fraction` past the second of them: cubic convolution with `A = -0.75`, as
/// OpenCV's `INTER_CUBIC`.
#[inline(always)]
pub fn cubic_weights(fraction: f32) -> [f32; 4] {
    const A: f32 = -0.75;
    let (before, after) = (fraction + 1.0, 1.0 - fraction);
    let outer = ((A * before - 5.0 * A) * before + 8.0 * A) * before - 4.0 * A;
    let near = ((A + 2.0) * fraction - (A + 3.0)) * fraction * fraction + 1.0;
    let far = ((A + 2.0) * after - (A + 3.0)) * after * after + 1.0;
    [outer, near, far, 1.0 - outer - near - far]
}

/// Replaces the inverse of zero: finite, so that zero times it is zero.
pub const INVERSE_OF_NOTHING: f32 = 1e30;

multiversioned! {
    /// Turns the warped frame into the constant part of the residual, and inverts the squared gradient.
    fn complete_row(
        x_line: &[f32],
        y_line: &[f32],
        value: &mut [f32],
        inverse_square: &mut [f32],
        first: &[f32],
        u: &[f32],
        v: &[f32],
    ) {
        for x in 0..value.len() {
            value[x] = value[x] - x_line[x] * u[x] - y_line[x] * v[x] - first[x];
            let square = x_line[x] * x_line[x] + y_line[x] * y_line[x];
            inverse_square[x] = if square > f32::EPSILON { 1.0 / square } else { INVERSE_OF_NOTHING };
        }
    }
}
