//! Polynomial expansion: around each pixel the image is fitted by `d^T A d + b^T d + c`, `d` the offset in pixels.

use rayon::prelude::*;
use srflow_core::{Plane, Size};

use srflow_simd::multiversioned;

/// Coefficients of the fit at one pixel, in this order: `b_x`, `b_y`, `A_xx`, `A_yy`, `2 A_xy`. `c` is not stored.
pub const COEFFICIENTS: usize = 5;

/// The fit at every pixel of an image.
#[derive(Debug, Clone)]
pub struct Expansion {
    pub width: usize,
    pub height: usize,
    /// Row-major, [`COEFFICIENTS`] per pixel, then [`PADDING`] zeros.
    pub coefficients: Vec<f32>,
}

/// Lets a reader load 8 numbers, a whole vector register, from the start of any pixel.
pub const PADDING: usize = 8 - COEFFICIENTS;

/// The weights of a fit: a normalised Gaussian `g` and the required entries of its inverse moment matrix.
#[derive(Debug, Clone)]
pub struct ExpansionKernel {
    /// `g(k)`, `k g(k)` and `k^2 g(k)` for `k` from 0 to the radius.
    pub g: Vec<[f32; 3]>,
    pub inverse: InverseMoments,
}

/// Entries of the inverse moment matrix of the basis 1, x, y, x^2, y^2, xy. The weight is separable, so x^2 and y^2 do
/// not mix.
#[derive(Debug, Clone, Copy)]
pub struct InverseMoments {
    /// (x, x) and (y, y).
    pub linear: f64,
    /// (1, x^2) and (1, y^2).
    pub constant_square: f64,
    /// (x^2, x^2) and (y^2, y^2).
    pub square: f64,
    /// (xy, xy).
    pub mixed: f64,
}

impl ExpansionKernel {
    /// `None` when the weight is so narrow that the moments cannot be inverted.
    pub fn new(radius: usize, sigma: f64) -> Option<Self> {
        let sigma = if sigma < f64::from(f32::EPSILON) { radius as f64 * 0.3 } else { sigma };
        let weight = |k: usize| libm::exp(-((k * k) as f64) / (2.0 * sigma * sigma)) as f32;
        let distances = (0..=2 * radius).map(|i| i.abs_diff(radius));
        let sum: f64 = distances.clone().map(|k| f64::from(weight(k))).sum();
        let normalised = |k: usize| {
            let g = (f64::from(weight(k)) * (1.0 / sum)) as f32;
            [g, k as f32 * g, (k * k) as f32 * g]
        };
        let g: Vec<[f32; 3]> = (0..=radius).map(normalised).collect();

        // Sums over the neighbourhood of g times 1, x^2, x^4 and x^2 y^2; products in single precision, as OpenCV's.
        let [mut one, mut xx, mut xxxx, mut xxyy] = [0.0_f64; 4];
        for y in distances.clone() {
            for x in distances.clone() {
                let (weight, x, y) = (g[y][0] * g[x][0], x as f32, y as f32);
                one += f64::from(weight);
                xx += f64::from(weight * x * x);
                xxxx += f64::from(weight * x * x * x * x);
                xxyy += f64::from(weight * x * x * y * y);
            }
        }
        let determinant = (xxxx - xxyy) * (one * (xxxx + xxyy) - 2.0 * xx * xx);
        let inverse = InverseMoments {
            linear: 1.0 / xx,
            constant_square: -xx * (xxxx - xxyy) / determinant,
            square: (one * xxxx - xx * xx) / determinant,
            mixed: 1.0 / xxyy,
        };
        let entries = [inverse.linear, inverse.constant_square, inverse.square, inverse.mixed];
        entries.iter().all(|entry| entry.is_finite()).then_some(Self { g, inverse })
    }

    pub fn radius(&self) -> usize {
        self.g.len() - 1
    }
}

/// Rows that one task expands.
const ROWS_PER_TASK: usize = 16;

impl Expansion {
    /// Fits every pixel of `image`, whose border pixels are repeated outside.
    pub fn of(image: &Plane, kernel: &ExpansionKernel) -> Self {
        let Size { width, height } = image.size();
        let mut coefficients = vec![0.0; width * height * COEFFICIENTS + PADDING];
        let (pixels, _) = coefficients.split_at_mut(width * height * COEFFICIENTS);
        let band_len = (width * COEFFICIENTS * ROWS_PER_TASK).max(1);
        pixels.par_chunks_mut(band_len).enumerate().for_each(|(band, out)| {
            let mut columns = ColumnMoments::new(width, kernel.radius());
            for (i, out) in out.chunks_exact_mut(width * COEFFICIENTS).enumerate() {
                columns.measure(image, band * ROWS_PER_TASK + i, kernel);
                fit_row(out, &columns.moments, kernel);
            }
        });
        Self { width, height, coefficients }
    }
}

/// Sums of `g`, `y g` and `y^2 g` times the image, down each column around one row; border columns are repeated `radius`
/// times on both sides. Space for a whole block follows.
struct ColumnMoments {
    radius: usize,
    moments: [Vec<f32>; 3],
}

impl ColumnMoments {
    fn new(width: usize, radius: usize) -> Self {
        Self { radius, moments: [0; 3].map(|_| vec![0.0; width + 2 * radius + BLOCK]) }
    }

    fn measure(&mut self, image: &Plane, y: usize, kernel: &ExpansionKernel) {
        let (width, last_row) = (image.width(), image.height() - 1);
        let radius = self.radius;
        let [zeroth, first, second] =
            self.moments.each_mut().map(|moment| &mut moment[radius..radius + width]);
        start_moments(zeroth, first, second, image.row(y), kernel.g[0][0]);
        for (k, g) in (1..).zip(&kernel.g[1..]) {
            let (above, below) = (image.row(y.saturating_sub(k)), image.row((y + k).min(last_row)));
            add_to_moments(zeroth, first, second, above, below, *g);
        }
        for moment in &mut self.moments {
            let (left, right) = (moment[radius], moment[radius + width - 1]);
            moment[..radius].fill(left);
            moment[radius + width..width + 2 * radius].fill(right);
        }
    }
}

fn start_moments(zeroth: &mut [f32], first: &mut [f32], second: &mut [f32], row: &[f32], g: f32) {
    for (moment, value) in zeroth.iter_mut().zip(row) {
        *moment = value * g;
    }
    first.fill(0.0);
    second.fill(0.0);
}

multiversioned! {
    fn add_to_moments(
        zeroth: &mut [f32],
        first: &mut [f32],
        second: &mut [f32],
        above: &[f32],
        below: &[f32],
        g: [f32; 3],
    ) {
        let len = zeroth.len();
        let (first, second, above, below) = (&mut first[..len], &mut second[..len], &above[..len], &below[..len]);
        for x in 0..len {
            let sum = above[x] + below[x];
            zeroth[x] += g[0] * sum;
            first[x] += g[1] * (below[x] - above[x]);
            second[x] += g[2] * sum;
        }
    }
}

/// Pixels that are fitted together.
const BLOCK: usize = 16;

multiversioned! {
    /// The fits of one row; sums along the row are in double precision, as OpenCV's.
    fn fit_row(out: &mut [f32], moments: &[Vec<f32>; 3], kernel: &ExpansionKernel) {
        let (radius, inverse) = (kernel.radius(), &kernel.inverse);
        for (block, out) in out.chunks_mut(BLOCK * COEFFICIENTS).enumerate() {
            let centre = block * BLOCK + radius;
            let zeroth = |at: usize| block_of(&moments[0], at);
            let first = |at: usize| block_of(&moments[1], at);
            let second = |at: usize| block_of(&moments[2], at);

            let g = kernel.g[0][0];
            let mut one = zeroth(centre).map(|moment| f64::from(moment * g));
            let mut of_y = first(centre).map(|moment| f64::from(moment * g));
            let mut of_yy = second(centre).map(|moment| f64::from(moment * g));
            let [mut of_x, mut of_xx, mut of_xy] = [[0.0_f64; BLOCK]; 3];
            for (k, g) in (1..=radius).zip(&kernel.g[1..]) {
                let (left0, right0) = (zeroth(centre - k), zeroth(centre + k));
                let (left1, right1) = (first(centre - k), first(centre + k));
                let (left2, right2) = (second(centre - k), second(centre + k));
                for i in 0..BLOCK {
                    let sum = f64::from(right0[i] + left0[i]);
                    one[i] += sum * f64::from(g[0]);
                    of_xx[i] += sum * f64::from(g[2]);
                    of_x[i] += f64::from((right0[i] - left0[i]) * g[1]);
                    of_y[i] += f64::from((right1[i] + left1[i]) * g[0]);
                    of_xy[i] += f64::from((right1[i] - left1[i]) * g[1]);
                    of_yy[i] += f64::from((right2[i] + left2[i]) * g[0]);
                }
            }
            let mut fits = [[0.0_f32; COEFFICIENTS]; BLOCK];
            for i in 0..BLOCK {
                let constant = one[i] * inverse.constant_square;
                fits[i] = [
                    (of_x[i] * inverse.linear) as f32,
                    (of_y[i] * inverse.linear) as f32,
                    (constant + of_xx[i] * inverse.square) as f32,
                    (constant + of_yy[i] * inverse.square) as f32,
                    (of_xy[i] * inverse.mixed) as f32,
                ];
            }
            let len = out.len();
            out.copy_from_slice(&fits.as_flattened()[..len]);
        }
    }
}

#[inline(always)]
fn block_of(moments: &[f32], start: usize) -> [f32; BLOCK] {
    let mut block = [0.0; BLOCK];
    block.copy_from_slice(&moments[start..start + BLOCK]);
    block
}
