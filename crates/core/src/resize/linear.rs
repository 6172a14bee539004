//! OpenCV's `INTER_LINEAR` (`modules/imgproc/src/resize.cpp`): output pixel `x` is at `(x + 0.5) * scale - 0.5` of the input,
//! pixel centres being integers, and the border pixel is repeated.

use rayon::prelude::*;
use srflow_simd::multiversioned;

use crate::{FlowField, Image, Mask, Plane, Size};

/// The sources of one output pixel along one axis: `near` and `far`, blended by `weight`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearTap {
    pub near: usize,
    pub far: usize,
    pub weight: f32,
}

impl LinearTap {
    /// At a position of an axis of `len` pixels; the border pixel is repeated. With weight 0 the two pixels are the same.
    pub fn at(position: f32, len: usize) -> Self {
        let weight = position - position.floor();
        let pixel = |place: i64| place.clamp(0, len as i64 - 1) as usize;
        let near = position.floor() as i64;
        Self { near: pixel(near), far: pixel(near + i64::from(weight > 0.0)), weight }
    }

    /// The weights of near and far in fixed point.
    fn fixed_weights(self) -> [i32; 2] {
        [1.0 - self.weight, self.weight].map(|part| (part * ONE as f32).round_ties_even() as i32)
    }
}

/// One in the fixed-point format of OpenCV's weights for 8-bit pictures.
const ONE: i32 = 1 << 11;

/// An image sampled at `columns` by `rows`, with OpenCV's fixed-point arithmetic.
pub fn sample_image(image: &Image, columns: &[LinearTap], rows: &[LinearTap]) -> Image {
    let columns: Vec<(usize, usize, [i32; 2])> =
        columns.iter().map(|tap| (tap.near, tap.far, tap.fixed_weights())).collect();
    let mut near = FixedRow::new(columns.len());
    let mut far = FixedRow::new(columns.len());
    let mut out = Image::new(columns.len(), rows.len());
    for (out, tap) in out.pixels_mut().chunks_exact_mut(columns.len().max(1)).zip(rows) {
        if far.row == Some(tap.near) || near.row == Some(tap.far) {
            std::mem::swap(&mut near, &mut far);
        }
        near.fill(image, tap.near, &columns);
        far.fill(image, tap.far, &columns);
        let [a, b] = tap.fixed_weights();
        let values = near.values.iter().zip(&far.values);
        for (out, (near, far)) in out.as_flattened_mut().iter_mut().zip(values) {
            *out = ((((a * (near >> 4)) >> 16) + ((b * (far >> 4)) >> 16) + 2) >> 2) as u8;
        }
    }
    out
}

/// A flow sampled at `columns` by `rows`, each component multiplied by its `factor`. A pixel with an unknown source is unknown.
pub fn sample_flow(
    flow: &FlowField,
    columns: &[LinearTap],
    rows: &[LinearTap],
    factor: [f32; 2],
) -> FlowField {
    FlowField::from_fn(columns.len(), rows.len(), |x, y| {
        let (column, row) = (columns[x], rows[y]);
        let along = |y: usize| {
            let (near, far) = (flow.get(column.near, y), flow.get(column.far, y));
            [0, 1].map(|c| near[c] * (1.0 - column.weight) + far[c] * column.weight)
        };
        let (near, far) = (along(row.near), along(row.far));
        let between = [0, 1].map(|c| (near[c] * (1.0 - row.weight) + far[c] * row.weight) * factor[c]);
        if between.iter().all(|c| c.is_finite()) { between } else { [f32::NAN; 2] }
    })
}

/// A mask sampled at `columns` by `rows`: true where the interpolated value is above one half.
pub fn sample_mask(mask: &Mask, columns: &[LinearTap], rows: &[LinearTap]) -> Mask {
    Mask::from_fn(columns.len(), rows.len(), |x, y| {
        let (column, row) = (columns[x], rows[y]);
        let along = |y: usize| {
            let [near, far] = [column.near, column.far].map(|x| f32::from(u8::from(mask.get(x, y))));
            near * (1.0 - column.weight) + far * column.weight
        };
        along(row.near) * (1.0 - row.weight) + along(row.far) * row.weight > 0.5
    })
}

/// A row of an image, resized along the row, in fixed point.
struct FixedRow {
    row: Option<usize>,
    values: Vec<i32>,
}

impl FixedRow {
    fn new(width: usize) -> Self {
        Self { row: None, values: vec![0; 3 * width] }
    }

    fn fill(&mut self, image: &Image, row: usize, columns: &[(usize, usize, [i32; 2])]) {
        if self.row == Some(row) {
            return;
        }
        self.row = Some(row);
        let line = image.row(row);
        for (out, (near, far, [a, b])) in self.values.as_chunks_mut::<3>().0.iter_mut().zip(columns) {
            let (near, far) = (line[*near], line[*far]);
            *out = std::array::from_fn(|c| i32::from(near[c]) * a + i32::from(far[c]) * b);
        }
    }
}

/// How a value between two pixels is computed. Farneback's iterations magnify the last bit of their input, so matching OpenCV's
/// results requires its rounding.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Rounding {
    /// OpenCV's single-channel version: `near + (far - near) * weight`, fused, from positions in double precision.
    Fused,
    /// OpenCV's two-channel version: `near * (1 - weight) + far * weight` from positions in single precision.
    Plain,
}

/// Rows that one task resizes: neighbouring output rows share horizontally resized input rows.
const ROWS_PER_TASK: usize = 32;

/// `INTER_LINEAR` of one channel to `size`, multiplied by `gain`.
pub fn resize_linear(input: &Plane, size: Size, gain: f32) -> Plane {
    resize(input, size, scales(input, size), gain, Rounding::Fused)
}

/// [`resize_linear`] with an explicit scale (input pixels per output pixel) instead of the ratio of the sizes.
pub fn resize_linear_by(input: &Plane, size: Size, scale: f64, gain: f32) -> Plane {
    resize(input, size, (scale, scale), gain, Rounding::Fused)
}

/// [`resize_linear`] as OpenCV computes it for pixels with two channels.
pub fn resize_linear_of_two(input: &Plane, size: Size, gain: f32) -> Plane {
    resize(input, size, scales(input, size), gain, Rounding::Plain)
}

fn scales(input: &Plane, Size { width, height }: Size) -> (f64, f64) {
    (input.width() as f64 / width as f64, input.height() as f64 / height as f64)
}

fn taps(input_len: usize, output_len: usize, scale: f64, rounding: Rounding) -> Vec<LinearTap> {
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
            LinearTap { near: 0, far: 0, weight: 0.0 }
        } else if whole as usize >= last {
            LinearTap { near: last, far: last, weight: 0.0 }
        } else {
            LinearTap { near: whole as usize, far: whole as usize + 1, weight }
        }
    };
    (0..output_len).map(tap).collect()
}

fn resize(
    input: &Plane,
    Size { width, height }: Size,
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

/// An input row, resized horizontally.
struct StretchedRow {
    row: Option<usize>,
    values: Vec<f32>,
}

impl StretchedRow {
    fn new(width: usize) -> Self {
        Self { row: None, values: vec![0.0; width] }
    }

    fn fill(&mut self, input: &Plane, row: usize, columns: &[LinearTap], rounding: Rounding) {
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
    fn stretch_fused(out: &mut [f32], line: &[f32], columns: &[LinearTap]) {
        for (out, tap) in out.iter_mut().zip(columns) {
            let (near, far) = (line[tap.near], line[tap.far]);
            *out = (far - near).mul_add(tap.weight, near);
        }
    }
}

fn stretch_plain(out: &mut [f32], line: &[f32], columns: &[LinearTap]) {
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
