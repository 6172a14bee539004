//! The evidence of each pixel for its displacement: the normal equations `G d = h` of the difference of the two fits.

use std::ops::Range;

use crate::block::block;

use super::expansion::{COEFFICIENTS, Expansion};
use super::strips::StripedFlow;
use srflow_simd::multiversioned;

/// Numbers of evidence per pixel, in this order: `G_yy`, `G_xy`, `G_xx`, `h_y`, `h_x`.
pub const CHANNELS: usize = 5;

/// Near the image's border the evidence counts less: weights by distance to the border.
const BORDER_WEIGHTS: [f32; 5] = [0.14, 0.14, 0.4472, 0.4472, 0.4472];

/// The weight of pixel `position` of `len`.
pub fn border_weight(position: usize, len: usize) -> f32 {
    let weight = |distance: usize| BORDER_WEIGHTS.get(distance).copied().unwrap_or(1.0);
    weight(position) * weight(len - 1 - position)
}

/// The evidence in a strip, for the rows around the current one.
pub struct EvidenceRows {
    /// The strip's columns, and those on both sides that the window reaches.
    pub columns: Range<usize>,
    /// How often the border columns are repeated on the left and right to fill the window.
    repeat: [usize; 2],
    radius: usize,
    height: usize,
    /// Row `y` is at `y % capacity`, in runs of `run` for each of [`CHANNELS`].
    rows: Vec<f32>,
    capacity: usize,
    /// The number of columns, rounded up to whole blocks.
    pub run: usize,
    gathered: usize,
    border: Vec<f32>,
    u: Vec<f32>,
    v: Vec<f32>,
}

impl EvidenceRows {
    pub fn new(strip: Range<usize>, width: usize, height: usize, radius: usize) -> Self {
        let columns = strip.start.saturating_sub(radius)..(strip.end + radius).min(width);
        let repeat = [radius - (strip.start - columns.start), radius - (columns.end - strip.end)];
        let run = columns.len().next_multiple_of(BLOCK);
        let capacity = (2 * radius + 2).min(height);
        Self {
            repeat,
            radius,
            height,
            rows: vec![0.0; capacity * run * CHANNELS],
            capacity,
            run,
            gathered: 0,
            border: columns.clone().map(|x| border_weight(x, width)).chain([0.0; BLOCK]).take(run).collect(),
            u: vec![0.0; run],
            v: vec![0.0; run],
            columns,
        }
    }

    /// Forgets all rows.
    pub fn restart(&mut self) {
        self.gathered = 0;
    }

    /// Computes the evidence that the window around row `y` needs. Rows must be requested downwards.
    pub fn gather_for(&mut self, y: usize, (first, second): (&Expansion, &Expansion), flow: &StripedFlow) {
        let row_len = self.run * CHANNELS;
        while self.gathered < (y + self.radius + 1).min(self.height) {
            let y = self.gathered;
            flow.copy_row(y, self.columns.clone(), &mut self.u, &mut self.v);
            let slot = y % self.capacity * row_len;
            let out = &mut self.rows[slot..slot + row_len];
            let part =
                RowPart { y, columns: self.columns.clone(), u: &self.u, v: &self.v, weight: &self.border };
            gather(out, first, second, &part);
            self.gathered += 1;
        }
    }

    /// The evidence of row `y`, or of the last row when `y` is beyond it.
    pub fn row(&self, y: usize) -> &[f32] {
        let row_len = self.run * CHANNELS;
        let slot = y.min(self.height - 1) % self.capacity * row_len;
        &self.rows[slot..slot + row_len]
    }

    /// One channel of a row, with the image's border columns repeated to fill the window.
    pub fn pad<T: Copy>(&self, padded: &mut Vec<T>, channel: &[T]) {
        let channel = &channel[..self.columns.len()];
        padded.clear();
        padded.extend(std::iter::repeat_n(channel[0], self.repeat[0]));
        padded.extend_from_slice(channel);
        padded.extend(std::iter::repeat_n(channel[channel.len() - 1], self.repeat[1]));
    }
}

/// Pixels that are processed together.
const BLOCK: usize = 16;

/// Weights by which the coefficients of both fits combine, per lane: half the sum of the quadratic parts (a quarter for
/// the mixed one, which the matrix holds twice) and half the difference of the linear parts.
const OF_FIRST: [f32; 8] = [0.5, 0.5, 0.5, 0.5, 0.25, 0.0, 0.0, 0.0];
const OF_SECOND: [f32; 8] = [-0.5, -0.5, 0.5, 0.5, 0.25, 0.0, 0.0, 0.0];
/// The same for flow that leaves the second frame: its fit is then that of the first, without the linear part.
const OF_FIRST_ALONE: [f32; 8] = [0.5, 0.5, 1.0, 1.0, 0.5, 0.0, 0.0, 0.0];

/// Part of a row in whole blocks: its columns, and the flow and border weight of each.
struct RowPart<'a> {
    y: usize,
    columns: Range<usize>,
    u: &'a [f32],
    v: &'a [f32],
    weight: &'a [f32],
}

multiversioned! {
    /// The evidence of part of a row: `out` holds one run of the part's length for each of the [`CHANNELS`].
    fn gather(out: &mut [f32], first: &Expansion, second: &Expansion, part: &RowPart) {
        let len = part.u.len();
        let row_weight = border_weight(part.y, first.height);
        let mut channels = out.chunks_exact_mut(len);
        let mut channel = || channels.next().unwrap_or_default();
        let [g_yy, g_xy, g_xx, h_y, h_x] = [(); CHANNELS].map(|()| channel());

        for start in (0..len).step_by(BLOCK) {
            let [u, v, weight] = [part.u, part.v, part.weight].map(|values| block::<BLOCK>(values, start));
            let columns = part.columns.start + start..(part.columns.start + start + BLOCK).min(part.columns.end);
            let fits = compare_fits(first, second, part.y, columns, &u, &v);

            // Coefficient by coefficient, so that the loop becomes vector instructions.
            let coefficient = |number: usize| std::array::from_fn::<f32, BLOCK, _>(|i| fits[i][number]);
            let [dx, dy, xx, yy, xy] = [0, 1, 2, 3, 4].map(coefficient);
            let mut evidence = [[0.0_f32; BLOCK]; CHANNELS];
            for i in 0..BLOCK {
                let scale = weight[i] * row_weight;
                let dx = (dx[i] + (xx[i] * u[i] + xy[i] * v[i])) * scale;
                let dy = (dy[i] + (yy[i] * v[i] + xy[i] * u[i])) * scale;
                let (xx, yy, xy) = (xx[i] * scale, yy[i] * scale, xy[i] * scale);
                evidence[0][i] = yy * yy + xy * xy;
                evidence[1][i] = (yy + xx) * xy;
                evidence[2][i] = xx * xx + xy * xy;
                evidence[3][i] = yy * dy + xy * dx;
                evidence[4][i] = xy * dy + xx * dx;
            }
            for (out, values) in [&mut *g_yy, g_xy, g_xx, h_y, h_x].into_iter().zip(&evidence) {
                out[start..start + BLOCK].copy_from_slice(values);
            }
        }
    }
}

/// The combined fit (`b_x`, `b_y`, `A_xx`, `A_yy`, `A_xy`, and three unused numbers) of a block of `columns` of row `y`:
/// the first frame with the second at the position that the flow points to.
#[inline(always)]
fn compare_fits(
    first: &Expansion,
    second: &Expansion,
    y: usize,
    columns: Range<usize>,
    u: &[f32; BLOCK],
    v: &[f32; BLOCK],
) -> [[f32; 8]; BLOCK] {
    let (width, height) = (first.width, first.height);
    let (last_x, last_y) = (width.saturating_sub(1) as f32, height.saturating_sub(1) as f32);
    let mut corners = [[0.0_f32; BLOCK]; 4];
    let mut left = [0_u32; BLOCK];
    let mut top = [0_u32; BLOCK];
    let mut inside = [false; BLOCK];
    for i in 0..BLOCK {
        let (target_x, target_y) = ((columns.start + i) as f32 + u[i], y as f32 + v[i]);
        let (whole_x, whole_y) = (target_x.floor(), target_y.floor());
        let (fx, fy) = (target_x - whole_x, target_y - whole_y);
        inside[i] = (whole_x >= 0.0) & (whole_y >= 0.0) & (whole_x < last_x) & (whole_y < last_y);
        left[i] = whole_number(if inside[i] { whole_x } else { 0.0 });
        top[i] = whole_number(if inside[i] { whole_y } else { 0.0 });
        corners[0][i] = (1.0 - fx) * (1.0 - fy);
        corners[1][i] = fx * (1.0 - fy);
        corners[2][i] = (1.0 - fx) * fy;
        corners[3][i] = fx * fy;
    }

    let mut fits = [[0.0_f32; 8]; BLOCK];
    for (i, x) in columns.enumerate() {
        let here = eight(first, y * width + x);
        if inside[i] {
            let at = top[i] as usize * width + left[i] as usize;
            let [a, b, c, d] = [at, at + 1, at + width, at + width + 1].map(|pixel| eight(second, pixel));
            for lane in 0..8 {
                let there = corners[0][i] * a[lane]
                    + corners[1][i] * b[lane]
                    + corners[2][i] * c[lane]
                    + corners[3][i] * d[lane];
                fits[i][lane] = here[lane] * OF_FIRST[lane] + there * OF_SECOND[lane];
            }
        } else {
            for lane in 0..8 {
                fits[i][lane] = here[lane] * OF_FIRST_ALONE[lane];
            }
        }
    }
    fits
}

/// A whole number from 0 to 2^23 - 1, which no image exceeds; a cast, which also has to serve all other numbers, is not vectorized.
#[inline(always)]
fn whole_number(x: f32) -> u32 {
    const MANTISSA: u32 = (1 << 23) - 1;
    (x + (1_u32 << 23) as f32).to_bits() & MANTISSA
}

/// The coefficients of a pixel and three unused numbers: a whole vector register.
#[inline(always)]
fn eight(expansion: &Expansion, pixel: usize) -> [f32; 8] {
    block(&expansion.coefficients, pixel * COEFFICIENTS)
}
