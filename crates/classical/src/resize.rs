//! Resizing as OpenCV does it (`modules/imgproc/src/resize.cpp`): an output pixel `x` sits at
//! `(x + 0.5) * scale - 0.5` of the input, pixel centres being integers, and the border pixel is repeated.

use rayon::prelude::*;
use srflow_field::Plane;

use crate::planar::PlanarFlow;
use srflow_simd::multiversioned;

/// Where one output pixel reads along one axis: between `near` and `far`, at `weight` of the way.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tap {
    near: usize,
    far: usize,
    weight: f32,
}

/// How a value between two pixels is computed. Farneback's iterations magnify the last bit of their input, so that
/// giving OpenCV's answers takes OpenCV's rounding.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rounding {
    /// As OpenCV resizes one channel: `near + (far - near) * weight`, fused, from positions in double precision.
    Fused,
    /// As OpenCV resizes two channels: `near * (1 - weight) + far * weight` from positions in single precision.
    Plain,
}

/// Rows that one task resizes, so that neighbouring output rows share the input rows stretched for them.
const ROWS_PER_TASK: usize = 32;

/// `INTER_LINEAR` of one channel to `width` x `height`, multiplied by `gain`.
pub fn resize_linear(input: &Plane, (width, height): (usize, usize), gain: f32) -> Plane {
    let scale = scales(input, (width, height));
    resize(input, (width, height), scale, gain, Rounding::Fused)
}

/// [`resize_linear`] by a scale (input pixels per output pixel) that is given rather than taken from the sizes.
pub fn resize_linear_by(input: &Plane, size: (usize, usize), scale: f64, gain: f32) -> Plane {
    resize(input, size, (scale, scale), gain, Rounding::Fused)
}

/// `INTER_LINEAR` of a flow of two channels to `width` x `height`, multiplied by `gain`.
pub fn resize_flow_linear(input: &PlanarFlow, size: (usize, usize), gain: f32) -> PlanarFlow {
    input.map(|plane| resize(plane, size, scales(plane, size), gain, Rounding::Plain))
}

fn scales(input: &Plane, (width, height): (usize, usize)) -> (f64, f64) {
    (input.width() as f64 / width as f64, input.height() as f64 / height as f64)
}

fn taps(input_len: usize, output_len: usize, scale: f64, rounding: Rounding) -> Vec<Tap> {
    let last = input_len.saturating_sub(1);
    let tap = |x: usize| {
        let position = (x as f64 + 0.5) * scale - 0.5;
        let (whole, weight) = match rounding {
            Rounding::Fused => (position.floor(), (position - position.floor()) as f32),
            Rounding::Plain => {
                let position = position as f32;
                (f64::from(position.floor()), position - position.floor())
            }
        };
        if whole < 0.0 {
            Tap { near: 0, far: 0, weight: 0.0 }
        } else if whole as usize >= last {
            Tap { near: last, far: last, weight: 0.0 }
        } else {
            Tap { near: whole as usize, far: whole as usize + 1, weight }
        }
    };
    (0..output_len).map(tap).collect()
}

fn resize(
    input: &Plane,
    (width, height): (usize, usize),
    scale: (f64, f64),
    gain: f32,
    rounding: Rounding,
) -> Plane {
    let mut output = Plane::new(width, height);
    if width == 0 || height == 0 {
        return output;
    }
    let columns = taps(input.width(), width, scale.0, rounding);
    let rows = taps(input.height(), height, scale.1, rounding);
    let bands = output.pixels_mut().par_chunks_mut(width * ROWS_PER_TASK).zip(rows.par_chunks(ROWS_PER_TASK));
    bands.for_each(|(band, rows)| {
        let mut near = StretchedRow::new(width);
        let mut far = StretchedRow::new(width);
        for (out, row) in band.chunks_exact_mut(width).zip(rows) {
            if far.row == Some(row.near) {
                std::mem::swap(&mut near, &mut far);
            }
            near.fill(input, row.near, &columns, rounding);
            far.fill(input, row.far, &columns, rounding);
            match rounding {
                Rounding::Fused => mix_rows_fused(out, &near.values, &far.values, row.weight, gain),
                Rounding::Plain => mix_rows_plain(out, &near.values, &far.values, row.weight, gain),
            }
        }
    });
    output
}

/// An input row resized along the row.
struct StretchedRow {
    row: Option<usize>,
    values: Vec<f32>,
}

impl StretchedRow {
    fn new(width: usize) -> Self {
        Self { row: None, values: vec![0.0; width] }
    }

    fn fill(&mut self, input: &Plane, row: usize, columns: &[Tap], rounding: Rounding) {
        if self.row == Some(row) {
            return;
        }
        self.row = Some(row);
        match rounding {
            Rounding::Fused => stretch_fused(&mut self.values, input.row(row), columns),
            Rounding::Plain => stretch_plain(&mut self.values, input.row(row), columns),
        }
    }
}

multiversioned! {
    fn stretch_fused(out: &mut [f32], line: &[f32], columns: &[Tap]) {
        for (out, tap) in out.iter_mut().zip(columns) {
            let (near, far) = (line[tap.near], line[tap.far]);
            *out = (far - near).mul_add(tap.weight, near);
        }
    }
}

fn stretch_plain(out: &mut [f32], line: &[f32], columns: &[Tap]) {
    for (out, tap) in out.iter_mut().zip(columns) {
        *out = line[tap.near] * (1.0 - tap.weight) + line[tap.far] * tap.weight;
    }
}

multiversioned! {
    fn mix_rows_fused(out: &mut [f32], near: &[f32], far: &[f32], weight: f32, gain: f32) {
        for ((out, near), far) in out.iter_mut().zip(near).zip(far) {
            *out = (far - near).mul_add(weight, *near) * gain;
        }
    }
}

multiversioned! {
    fn mix_rows_plain(out: &mut [f32], near: &[f32], far: &[f32], weight: f32, gain: f32) {
        for ((out, near), far) in out.iter_mut().zip(near).zip(far) {
            *out = (near * (1.0 - weight) + far * weight) * gain;
        }
    }
}

/// `INTER_AREA` to a smaller or equal size: each output pixel is the mean of the input under it, multiplied by `gain`.
pub fn shrink_area(input: &Plane, (width, height): (usize, usize), gain: f32) -> Plane {
    let columns = area_taps(input.width(), width);
    let rows = area_taps(input.height(), height);
    Plane::from_fn(width, height, |x, y| {
        let across = |row: usize| -> f32 {
            let line = input.row(row);
            columns[x].iter().map(|&(column, share)| line[column] * share).sum()
        };
        rows[y].iter().map(|&(row, share)| across(row) * share).sum::<f32>() * gain
    })
}

/// For each output pixel the input pixels it covers and the share of each; the shares sum to 1.
fn area_taps(input_len: usize, output_len: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = input_len as f64 / output_len as f64;
    let covered = |x: usize| {
        let start = x as f64 * scale;
        let end = (start + scale).min(input_len as f64);
        let first = start as usize;
        let last = (end.ceil() as usize).clamp(first + 1, input_len.max(first + 1));
        let share = |i: usize| (end.min(i as f64 + 1.0) - start.max(i as f64)) / (end - start);
        (first..last).map(|i| (i, share(i) as f32)).collect()
    };
    (0..output_len).map(covered).collect()
}
