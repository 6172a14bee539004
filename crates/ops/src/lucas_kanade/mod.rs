//! What brightness alone says about the motion between two frames that nearly match: the solution of Lucas and Kanade (1981) in
//! windows around each cell of 2x2 pixels, regularized by the noise. [`mod@reference`] is the definition.

use rayon::prelude::*;
use srflow_simd::zeros;

use crate::MapShape;

mod composed;
pub mod reference;
pub mod tensor;

/// Side of a cell in pixels.
pub const CELL: usize = 2;
/// Outputs per window: the motion `u` and `v` in pixels, and how much of `u` and of `v` the frames determine, 0 to 1.
pub const PER_WINDOW: usize = 4;
/// Means over a window: of `xx`, `xy`, `yy`, `xt` and `yt`, where `x` and `y` are slopes of brightness and `t` its change.
const PRODUCTS: usize = 5;

/// Windows and regularization.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LucasKanade {
    /// Radius of each window, in cells; windows are cut off at the border.
    pub radii: [usize; 2],
    /// Added to the mean squared slopes in both directions: the variance of noise.
    pub noise: f32,
    /// Components of the motion are cut off at this length, in pixels.
    pub reach: f32,
}

impl LucasKanade {
    /// Channels of the output.
    pub const OUTPUTS: usize = 2 * PER_WINDOW;

    /// The motion of the mean of all channels from `first` to `second`, both of `shape` with an even height and width:
    /// `[batch, OUTPUTS, height / 2, width / 2]`. Panics when the lengths of the slices or the sizes do not fit.
    pub fn forward(&self, first: &[f32], second: &[f32], shape: MapShape) -> Vec<f32> {
        assert_eq!(first.len(), shape.elements(), "first frames of {shape:?}");
        assert_eq!(second.len(), shape.elements(), "second frames of {shape:?}");
        let cells = in_cells(shape);
        let mut out = zeros(cells.elements());
        if out.is_empty() {
            return out;
        }
        let pixels = shape.pixels();
        for (n, out) in out.chunks_exact_mut(Self::OUTPUTS * cells.pixels()).enumerate() {
            let frame = |frames: &[f32]| mean_of_channels(&frames[n * shape.channels * pixels..], shape);
            let products = Products::new(&frame(first), &frame(second), shape);
            for (radius, out) in self.radii.into_iter().zip(out.chunks_exact_mut(PER_WINDOW * cells.pixels()))
            {
                self.solve(&products.over_windows(radius), out);
            }
        }
        out
    }

    /// Of one window around each cell.
    fn solve(&self, means: &[Vec<f32>; PRODUCTS], out: &mut [f32]) {
        let cells = means[0].len();
        let (u, rest) = out.split_at_mut(cells);
        let (v, rest) = rest.split_at_mut(cells);
        let (of_u, of_v) = rest.split_at_mut(cells);
        let limited = |x: f32| x.clamp(-self.reach, self.reach);
        for cell in 0..cells {
            let [xx, xy, yy, xt, yt] = std::array::from_fn(|product| means[product][cell]);
            let (noisy_xx, noisy_yy) = (xx + self.noise, yy + self.noise);
            let determinant = noisy_xx * noisy_yy - xy * xy;
            u[cell] = limited((xy * yt - noisy_yy * xt) / determinant);
            v[cell] = limited((xy * xt - noisy_xx * yt) / determinant);
            of_u[cell] = xx / noisy_xx;
            of_v[cell] = yy / noisy_yy;
        }
    }
}

/// The output's size.
fn in_cells(shape: MapShape) -> MapShape {
    let MapShape { batch, height, width, .. } = shape;
    assert_eq!([height % CELL, width % CELL], [0, 0], "whole cells in {shape:?}");
    MapShape { batch, channels: LucasKanade::OUTPUTS, height: height / CELL, width: width / CELL }
}

/// Of the first image of `frames`.
fn mean_of_channels(frames: &[f32], shape: MapShape) -> Vec<f32> {
    let mut mean = frames[..shape.pixels()].to_vec();
    for channel in frames.chunks_exact(shape.pixels()).take(shape.channels).skip(1) {
        mean.iter_mut().zip(channel).for_each(|(sum, x)| *sum += x);
    }
    let share = 1.0 / shape.channels as f32;
    mean.iter_mut().for_each(|sum| *sum *= share);
    mean
}

/// The mean products of slopes and change in each cell.
struct Products {
    height: usize,
    width: usize,
    means: [Vec<f32>; PRODUCTS],
}

impl Products {
    fn new(first: &[f32], second: &[f32], shape: MapShape) -> Self {
        let MapShape { height, width, .. } = shape;
        let rows = |y: usize| {
            let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)];
            [above, y, below].map(|y| [first, second].map(|frame| &frame[y * width..][..width]))
        };
        // Slopes are half of the difference of both neighbours, in the mean of both frames.
        let pixel = |[above, here, below]: [[&[f32]; 2]; 3], x: usize| {
            let both = |row: [&[f32]; 2], x: usize| row[0][x] + row[1][x];
            let dx = 0.25 * (both(here, (x + 1).min(width - 1)) - both(here, x.saturating_sub(1)));
            let dy = 0.25 * (both(below, x) - both(above, x));
            let dt = here[1][x] - here[0][x];
            [dx * dx, dx * dy, dy * dy, dx * dt, dy * dt]
        };
        let (height, width) = (height / CELL, width / CELL);
        let row = |y: usize| {
            let [upper, lower] = [rows(CELL * y), rows(CELL * y + 1)];
            let cell = |x: usize| {
                let four =
                    [(upper, CELL * x), (upper, CELL * x + 1), (lower, CELL * x), (lower, CELL * x + 1)]
                        .map(|(rows, x)| pixel(rows, x));
                std::array::from_fn::<f32, PRODUCTS, _>(|i| {
                    0.25 * (four[0][i] + four[1][i] + four[2][i] + four[3][i])
                })
            };
            (0..width).map(cell).collect::<Vec<_>>()
        };
        let rows: Vec<Vec<[f32; PRODUCTS]>> = (0..height).into_par_iter().map(row).collect();
        let means = std::array::from_fn(|i| rows.iter().flatten().map(|cell| cell[i]).collect());
        Self { height, width, means }
    }

    /// Means over the window of this radius around each cell.
    fn over_windows(&self, radius: usize) -> [Vec<f32>; PRODUCTS] {
        let Self { height, width, .. } = *self;
        let window = |i: usize, size: usize| i.saturating_sub(radius)..(i + radius + 1).min(size);
        let mean = |plane: &Vec<f32>| {
            let mut along_rows = vec![0.0; plane.len()];
            along_rows.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(to, row)| {
                for (x, to) in to.iter_mut().enumerate() {
                    *to = row[window(x, width)].iter().sum();
                }
            });
            let mut out = vec![0.0; plane.len()];
            out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
                let rows = window(y, height);
                for row in rows.clone() {
                    let row = &along_rows[row * width..][..width];
                    out.iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
                }
                for (x, sum) in out.iter_mut().enumerate() {
                    *sum /= (rows.len() * window(x, width).len()) as f32;
                }
            });
            out
        };
        self.means.each_ref().map(mean)
    }
}

#[cfg(test)]
pub(crate) mod tests;
