//! Resizing with OpenCV's conventions (`modules/imgproc/src/resize.cpp`): pixel centres at integers, an output pixel
//! `x` sits at `(x + 0.5) * scale - 0.5` of the input, and the border pixel is repeated.

use rayon::prelude::*;
use srflow_field::Plane;

/// Where one output pixel reads along one axis: `(1 - weight) * input[near] + weight * input[far]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearTap {
    pub near: usize,
    pub far: usize,
    pub weight: f32,
}

/// The taps of `INTER_LINEAR` along an axis; `scale` is input pixels per output pixel.
pub fn linear_taps(input_len: usize, output_len: usize, scale: f64) -> Vec<LinearTap> {
    let last = input_len.saturating_sub(1);
    (0..output_len)
        .map(|x| {
            let position = ((x as f64 + 0.5) * scale - 0.5) as f32;
            let near = position.floor();
            if near < 0.0 {
                LinearTap { near: 0, far: 0, weight: 0.0 }
            } else if near as usize >= last {
                LinearTap { near: last, far: last, weight: 0.0 }
            } else {
                LinearTap { near: near as usize, far: near as usize + 1, weight: position - near }
            }
        })
        .collect()
}

/// `INTER_LINEAR` to `width` x `height`, the result multiplied by `gain`.
pub fn resize_linear(input: &Plane, width: usize, height: usize, gain: f32) -> Plane {
    let scale_x = input.width() as f64 / width as f64;
    let scale_y = input.height() as f64 / height as f64;
    resize_linear_by(input, (width, height), (scale_x, scale_y), gain)
}

/// [`resize_linear`] with the scale (input pixels per output pixel) given rather than taken from the sizes.
pub fn resize_linear_by(input: &Plane, size: (usize, usize), scale: (f64, f64), gain: f32) -> Plane {
    let (width, height) = size;
    let columns = linear_taps(input.width(), width, scale.0);
    let rows = linear_taps(input.height(), height, scale.1);
    let mut output = Plane::new(width, height);
    output.pixels_mut().par_chunks_mut(width.max(1)).zip(rows.par_iter()).for_each(|(out, row)| {
        let (upper, lower) = (input.row(row.near), input.row(row.far));
        for (out, column) in out.iter_mut().zip(&columns) {
            let across =
                |line: &[f32]| line[column.near] * (1.0 - column.weight) + line[column.far] * column.weight;
            *out = (across(upper) * (1.0 - row.weight) + across(lower) * row.weight) * gain;
        }
    });
    output
}

/// `INTER_AREA` to a smaller or equal size: each output pixel is the mean of the input under it, the result
/// multiplied by `gain`.
pub fn shrink_area(input: &Plane, width: usize, height: usize, gain: f32) -> Plane {
    let columns = area_taps(input.width(), width);
    let rows = area_taps(input.height(), height);
    Plane::from_fn(width, height, |x, y| {
        let mut sum = 0.0;
        for &(row, row_weight) in &rows[y] {
            let line = input.row(row);
            let across: f32 = columns[x].iter().map(|&(column, weight)| line[column] * weight).sum();
            sum += across * row_weight;
        }
        sum * gain
    })
}

/// For each output pixel the input pixels it covers and the share of each; the shares sum to 1.
fn area_taps(input_len: usize, output_len: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = input_len as f64 / output_len as f64;
    (0..output_len)
        .map(|x| {
            let start = x as f64 * scale;
            let end = (start + scale).min(input_len as f64);
            let first = start.floor() as usize;
            let last = (end.ceil() as usize).clamp(first + 1, input_len);
            (first..last)
                .map(|i| (i, ((end.min(i as f64 + 1.0) - start.max(i as f64)) / (end - start)) as f32))
                .collect()
        })
        .collect()
}
