//! The loss between two pictures, with its gradient. A row of a picture is filtered as `3 width` numbers, whose neighbours in one
//! channel are three apart, first along the columns, then along the row.

pub mod reference;

use rayon::prelude::*;
use srflow_core::Size;
use srflow_simd::{Isa, MAX_LANES, Simd, dispatch};

use reference::{C1, C2, RADIUS, WINDOW_LEN, window};

/// A picture's list of pixels has the wrong length.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the {picture} picture has {found} pixels; {size} (WIDTHxHEIGHT) needs {}", .size.pixels())]
pub struct ImageLossError {
    /// `rendered` or `target`.
    picture: &'static str,
    found: usize,
    size: Size,
}

/// See [`ImageLoss`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ImageLossValue {
    /// `(1 - w) L1 + w (1 - SSIM)`.
    pub total: f64,
    /// Mean absolute difference of the channels.
    pub l1: f64,
    /// Mean structural similarity of the channels, 1 for equal pictures.
    pub ssim: f64,
}

/// The loss of 3D Gaussian Splatting (Kerbl et al. 2023, equation 7): `(1 - w) L1 + w (1 - SSIM)`, where SSIM has a Gaussian
/// window of 11x11 pixels and standard deviation 1.5, zeros outside the picture, and the constants 0.01^2 and 0.03^2
/// (graphdeco-inria/gaussian-splatting, `utils/loss_utils.py`). [`reference::loss`] is the definition.
///
/// Keeps its buffers between calls. Results do not depend on the number of threads or the processor.
#[derive(Debug)]
pub struct ImageLoss {
    /// The weight `w` of SSIM.
    pub ssim_weight: f64,
    isa: Isa,
    /// For each row of the picture, one row each of the derivatives of SSIM with respect to the mean of the rendered picture,
    /// to the mean of its square, and to the mean of its product with the target.
    derivatives: Vec<f32>,
}

impl Default for ImageLoss {
    /// The weight of the paper, 0.2.
    fn default() -> Self {
        Self { ssim_weight: 0.2, isa: Isa::best(), derivatives: Vec::new() }
    }
}

impl ImageLoss {
    /// The loss of a `rendered` picture, and its gradient with respect to each of its numbers, which replaces the contents of
    /// `gradient`. Pictures are row-major, with values of about 0..1. The absolute difference has the gradient 0 at 0.
    ///
    /// # Errors
    /// When a picture does not have this size.
    pub fn backward(
        &mut self,
        rendered: &[[f32; 3]],
        target: &[[f32; 3]],
        size: Size,
        gradient: &mut Vec<[f32; 3]>,
    ) -> Result<ImageLossValue, ImageLossError> {
        let count = size.pixels();
        for (picture, found) in [("rendered", rendered.len()), ("target", target.len())] {
            if found != count {
                return Err(ImageLossError { picture, found, size });
            }
        }
        gradient.resize(count, [0.0; 3]);
        if count == 0 {
            return Ok(ImageLossValue { ssim: 1.0, ..ImageLossValue::default() });
        }
        let Size { width, height } = size;
        let numbers = (3 * count) as f64;
        let row = 3 * width;
        let stride = row.next_multiple_of(MAX_LANES);
        let pair = Pair {
            rendered: rendered.as_flattened(),
            target: target.as_flattened(),
            row,
            stride,
            height,
            window: window().map(|weight| weight as f32),
        };
        let isa = self.isa;
        self.derivatives.resize(3 * stride * height, 0.0);
        let similarities: Vec<f64> = self
            .derivatives
            .par_chunks_mut(3 * stride)
            .enumerate()
            .map_init(|| Scratch::new(stride), |scratch, (y, out)| similarity(isa, pair, y, scratch, out))
            .collect();
        let factors = [(1.0 - self.ssim_weight) / numbers, -self.ssim_weight / numbers];
        let (derivatives, factors) = (&self.derivatives[..], factors.map(|factor| factor as f32));
        let differences: Vec<f64> = gradient
            .as_flattened_mut()
            .par_chunks_mut(row)
            .enumerate()
            .map_init(
                || Scratch::new(stride),
                |scratch, (y, out)| gradient_row(isa, pair, derivatives, factors, y, scratch, out),
            )
            .collect();
        let l1 = differences.iter().sum::<f64>() / numbers;
        let ssim = similarities.iter().sum::<f64>() / numbers;
        let total = (1.0 - self.ssim_weight) * l1 + self.ssim_weight * (1.0 - ssim);
        Ok(ImageLossValue { total, l1, ssim })
    }
}

/// Two pictures as numbers.
#[derive(Clone, Copy)]
struct Pair<'a> {
    rendered: &'a [f32],
    target: &'a [f32],
    /// Numbers in a row.
    row: usize,
    /// The same, filled up to whole vectors.
    stride: usize,
    height: usize,
    window: [f32; WINDOW_LEN],
}

impl Pair<'_> {
    /// The rows under the window at row `y`, each with its weight.
    #[inline(always)]
    fn rows(&self, y: usize) -> impl Iterator<Item = (usize, f32)> {
        let (first, end) = (y.saturating_sub(RADIUS), (y + RADIUS + 1).min(self.height));
        (first..end).zip(self.window.into_iter().skip(RADIUS - (y - first)))
    }
}

/// Zeros to each side of a row, at least as many as the window reaches.
const MARGIN: usize = 16;

/// Rows filtered along the columns.
struct Scratch {
    /// Five rows of `MARGIN + stride + MARGIN` numbers.
    rows: [Vec<f32>; 5],
    /// One number for each of the picture's row.
    values: Vec<f32>,
}

impl Scratch {
    fn new(stride: usize) -> Self {
        Self { rows: std::array::from_fn(|_| vec![0.0; stride + 2 * MARGIN]), values: vec![0.0; stride] }
    }
}

/// The vector at `at`, with zeros beyond the end of the row.
#[inline(always)]
fn read<S: Simd>(s: S, row: &[f32], at: usize) -> S::Vector {
    s.read_first(&row[at.min(row.len())..])
}

/// The window along a row with margins, at number `at`.
#[inline(always)]
fn filter<S: Simd>(s: S, window: &[f32; WINDOW_LEN], row: &[f32], at: usize) -> S::Vector {
    let under = &row[MARGIN + at - 3 * RADIUS..];
    let mut sum = s.mul(s.splat(window[0]), s.read(under));
    for (tap, &weight) in window.iter().enumerate().skip(1) {
        sum = s.mul_add(s.splat(weight), s.read(&under[3 * tap..]), sum);
    }
    sum
}

/// The sum of numbers, in an order that does not depend on the instruction set.
#[inline(always)]
fn sum(numbers: &[f32]) -> f64 {
    let mut sums = [0.0; MAX_LANES];
    for numbers in numbers.chunks(MAX_LANES) {
        for (sum, &number) in sums.iter_mut().zip(numbers) {
            *sum += f64::from(number);
        }
    }
    sums.iter().sum()
}

dispatch! {
    /// See [`similarity_kernel`].
    fn similarity = similarity_kernel(pair: Pair<'_>, y: usize, scratch: &mut Scratch, out: &mut [f32]) -> f64
}

/// The derivatives of SSIM at row `y`, one after another, and the sum of SSIM over the row.
#[inline(always)]
fn similarity_kernel<S: Simd>(s: S, pair: Pair<'_>, y: usize, scratch: &mut Scratch, out: &mut [f32]) -> f64 {
    let Scratch { rows, values } = scratch;
    for at in (0..pair.stride).step_by(S::LANES) {
        let mut sums = [s.splat(0.0); 5];
        for (row, weight) in pair.rows(y) {
            let span = row * pair.row..(row + 1) * pair.row;
            let (a, b) = (read(s, &pair.rendered[span.clone()], at), read(s, &pair.target[span], at));
            let weight = s.splat(weight);
            let (wa, wb) = (s.mul(weight, a), s.mul(weight, b));
            sums[0] = s.add(sums[0], wa);
            sums[1] = s.add(sums[1], wb);
            sums[2] = s.mul_add(wa, a, sums[2]);
            sums[3] = s.mul_add(wa, b, sums[3]);
            sums[4] = s.mul_add(wb, b, sums[4]);
        }
        for (row, sum) in rows.iter_mut().zip(sums) {
            s.write(sum, &mut row[MARGIN + at..]);
        }
    }
    let (of_mean, rest) = out.split_at_mut(pair.stride);
    let (of_square, of_product) = rest.split_at_mut(pair.stride);
    let (zero, one, two) = (s.splat(0.0), s.splat(1.0), s.splat(2.0));
    let (c1, c2) = (s.splat(C1 as f32), s.splat(C2 as f32));
    for at in (0..pair.stride).step_by(S::LANES) {
        let mean_a = filter(s, &pair.window, &rows[0], at);
        let mean_b = filter(s, &pair.window, &rows[1], at);
        let square_a = filter(s, &pair.window, &rows[2], at);
        let product = filter(s, &pair.window, &rows[3], at);
        let square_b = filter(s, &pair.window, &rows[4], at);
        let means = s.mul(mean_a, mean_b);
        let squares = s.mul_add(mean_a, mean_a, s.mul(mean_b, mean_b));
        let a1 = s.mul_add(two, means, c1);
        let b1 = s.add(squares, c1);
        let a2 = s.mul_add(two, s.sub(product, means), c2);
        // Variances are not negative, but their rounding errors may be.
        let b2 = s.add(s.max(s.sub(s.add(square_a, square_b), squares), zero), c2);
        let (over_b1, over_b2) = (s.div(one, b1), s.div(one, b2));
        let over = s.mul(over_b1, over_b2);
        let value = s.mul(s.mul(a1, a2), over);
        let by_product = s.mul(s.mul(two, a1), over);
        let by_mean = s.mul(s.mul(two, mean_b), s.mul(s.sub(a2, a1), over));
        let balance = s.mul(s.mul(two, mean_a), s.mul(value, s.sub(over_b2, over_b1)));
        s.write(s.add(by_mean, balance), &mut of_mean[at..]);
        s.write(s.sub(zero, s.mul(value, over_b2)), &mut of_square[at..]);
        s.write(by_product, &mut of_product[at..]);
        s.write(value, &mut values[at..]);
    }
    // Beyond the end of the row there is no picture.
    for row in [of_mean, of_square, of_product] {
        row[pair.row..].fill(0.0);
    }
    sum(&values[..pair.row])
}

dispatch! {
    /// See [`gradient_kernel`].
    fn gradient_row = gradient_kernel(
        pair: Pair<'_>,
        derivatives: &[f32],
        factors: [f32; 2],
        y: usize,
        scratch: &mut Scratch,
        out: &mut [f32],
    ) -> f64
}

/// The gradient at row `y`, given the factors of the L1's and the SSIM's, and the sum of absolute differences over the row.
#[inline(always)]
fn gradient_kernel<S: Simd>(
    s: S,
    pair: Pair<'_>,
    derivatives: &[f32],
    [l1, ssim]: [f32; 2],
    y: usize,
    scratch: &mut Scratch,
    out: &mut [f32],
) -> f64 {
    let Scratch { rows, values } = scratch;
    let [mean, square, product, ..] = rows;
    for at in (0..pair.stride).step_by(S::LANES) {
        let mut sums = [s.splat(0.0); 3];
        for (row, weight) in pair.rows(y) {
            let weight = s.splat(weight);
            for (i, sum) in sums.iter_mut().enumerate() {
                *sum = s.mul_add(weight, s.read(&derivatives[(3 * row + i) * pair.stride + at..]), *sum);
            }
        }
        s.write(sums[0], &mut mean[MARGIN + at..]);
        s.write(sums[1], &mut square[MARGIN + at..]);
        s.write(sums[2], &mut product[MARGIN + at..]);
    }
    let span = y * pair.row..(y + 1) * pair.row;
    let (rendered, target) = (&pair.rendered[span.clone()], &pair.target[span]);
    let zero = s.splat(0.0);
    for at in (0..pair.stride).step_by(S::LANES) {
        let (a, b) = (read(s, rendered, at), read(s, target, at));
        let mut similarity = filter(s, &pair.window, mean, at);
        let twice = s.mul(s.splat(2.0), a);
        similarity = s.mul_add(twice, filter(s, &pair.window, square, at), similarity);
        similarity = s.mul_add(b, filter(s, &pair.window, product, at), similarity);
        let difference = s.sub(a, b);
        let sign = s.select(
            s.greater(difference, zero),
            s.splat(l1),
            s.select(s.greater(zero, difference), s.splat(-l1), zero),
        );
        let gradient = s.mul_add(s.splat(ssim), similarity, sign);
        s.write(s.sub(zero, s.negative(difference)), &mut values[at..]);
        s.write_first(gradient, &mut out[at.min(pair.row)..]);
    }
    sum(&values[..pair.row])
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;

    use super::*;

    type Picture = Vec<[f32; 3]>;

    /// A picture of smooth shapes with noise, and one somewhat like it, of values beyond 0..1 too.
    fn pictures(size: Size, seed: u64) -> (Picture, Picture) {
        let Size { width, height } = size;
        let mut stream = Key::new(seed).stream("pictures");
        let target: Picture = (0..size.pixels())
            .map(|i| {
                let (x, y) = ((i % width) as f32, (i / width) as f32);
                let wave = 0.5 + 0.4 * libm::sinf(0.4 * x + 0.1 * y * y / height as f32);
                [wave, 0.6 * wave + 0.1 * stream.unit(), if x > y { 0.9 } else { 0.0 }]
            })
            .collect();
        let mut near = |value: f32| value + 0.15 * stream.normal();
        let rendered = target.iter().map(|pixel| pixel.map(&mut near)).collect();
        (rendered, target)
    }

    const SIZES: [Size; 5] =
        [Size::new(23, 17), Size::new(5, 40), Size::new(1, 1), Size::new(64, 3), Size::new(37, 29)];

    #[test]
    fn the_definition_has_its_central_differences_as_gradient() {
        let (size, w) = (Size::new(13, 9), 0.2);
        let (rendered, target) = pictures(size, 1);
        let exact = |picture: &Picture| -> Vec<[f64; 3]> {
            picture.iter().map(|pixel| pixel.map(f64::from)).collect()
        };
        let (mut rendered, target) = (exact(&rendered), exact(&target));
        let (_, gradient) = reference::loss(&rendered, &target, size, w);
        for i in 0..rendered.len() {
            for channel in 0..3 {
                let mut at = |step: f64| {
                    rendered[i][channel] += step;
                    let value = reference::loss(&rendered, &target, size, w).0.total;
                    rendered[i][channel] -= step;
                    value
                };
                let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                let found = gradient[i][channel];
                assert!((found - difference).abs() < 1e-8, "{i}, {channel}: {found}, {difference}");
            }
        }
    }

    #[test]
    fn the_fast_loss_agrees_with_the_definition() {
        for (seed, size) in SIZES.into_iter().enumerate() {
            let (rendered, target) = pictures(size, seed as u64);
            let mut loss = ImageLoss::default();
            let mut gradient = vec![[f32::NAN; 3]; 7];
            let value = loss.backward(&rendered, &target, size, &mut gradient).unwrap();
            let exact = |picture: &Picture| -> Vec<[f64; 3]> {
                picture.iter().map(|pixel| pixel.map(f64::from)).collect()
            };
            let (expected, slopes) = reference::loss(&exact(&rendered), &exact(&target), size, 0.2);
            assert!((value.l1 - expected.l1).abs() < 1e-6, "{size}");
            assert!((value.ssim - expected.ssim).abs() < 1e-5, "{value:?}, {expected:?}");
            assert!((value.total - expected.total).abs() < 1e-5);
            let scale = 1.0 / (3 * size.pixels()) as f64;
            for (found, expected) in gradient.as_flattened().iter().zip(slopes.as_flattened()) {
                let error = (f64::from(*found) - expected).abs();
                assert!(error < 1e-3 * (expected.abs() + scale), "{size}: {found}, {expected}");
            }
        }
    }

    #[test]
    fn equal_pictures_have_no_loss_and_no_gradient() {
        let size = Size::new(40, 30);
        let (_, target) = pictures(size, 3);
        let mut gradient = Vec::new();
        let value = ImageLoss::default().backward(&target, &target, size, &mut gradient).unwrap();
        assert!(value.total.abs() < 1e-6 && (value.ssim - 1.0).abs() < 1e-6);
        assert!(gradient.as_flattened().iter().all(|gradient| gradient.abs() < 1e-7));
    }

    #[test]
    fn the_loss_has_the_same_bits_on_every_processor_and_number_of_threads() {
        let (size, small) = (Size::new(101, 67), Size::new(50, 20));
        let (rendered, target) = pictures(size, 4);
        let run = |isa: Isa, threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut loss = ImageLoss { isa, ..ImageLoss::default() };
            let mut gradient = Vec::new();
            let value = pool.install(|| loss.backward(&rendered, &target, size, &mut gradient)).unwrap();
            // A second picture leaves nothing of the first.
            let (other, _) = pictures(small, 5);
            loss.backward(&other, &other, small, &mut Vec::new()).unwrap();
            assert_eq!(loss.backward(&rendered, &target, size, &mut gradient), Ok(value));
            (value, gradient)
        };
        let expected = run(Isa::best(), 1);
        for isa in Isa::to_test() {
            for threads in [1, 2, 5] {
                assert!(run(isa, threads) == expected, "{isa:?}, {threads} threads");
            }
        }
    }

    #[test]
    fn pictures_of_another_size_are_refused() {
        let error = ImageLoss::default()
            .backward(&[[0.0; 3]; 6], &[[0.0; 3]; 5], Size::new(3, 2), &mut Vec::new())
            .unwrap_err();
        assert_eq!(error.to_string(), "the target picture has 5 pixels; 3x2 (WIDTHxHEIGHT) needs 6");
    }
}
