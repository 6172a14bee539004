use rayon::prelude::*;

use super::FeaturePyramid;
use super::pyramid::{Level, channels_first, channels_last};
use crate::simd::{Isa, Simd, dispatch};

/// Window of the correlation pyramid around `coords`: `[batch, levels * (2 radius + 1)^2, height, width]`.
///
/// `first` is the feature map of the first image, `[batch, height, width, channels]`; `coords` are positions in the
/// second image, `[batch, 2, height, width]`, x then y, in pixels of the finest level. Products are divided by
/// `sqrt(channels)`; outside of the second image they are zero. The order of a window's entries is the reference's; see
/// [`super::reference::correlation_lookup`]. Panics when a slice does not fit.
pub fn correlation_lookup(
    first: &[f32],
    second: &FeaturePyramid,
    coords: &[f32],
    [height, width]: [usize; 2],
    radius: usize,
) -> Vec<f32> {
    lookup_with(Isa::best(), first, second, coords, [height, width], radius)
}

/// [`correlation_lookup`] with a chosen instruction set, one of [`Isa::available`].
pub(super) fn lookup_with(
    isa: Isa,
    first: &[f32],
    second: &FeaturePyramid,
    coords: &[f32],
    [height, width]: [usize; 2],
    radius: usize,
) -> Vec<f32> {
    let windows = Windows::new(first, second, coords, [height, width], radius);
    let entries = windows.entries();
    let pixels = height * width;
    // Row by row, a pixel's entries side by side; channels go first at the end.
    let mut out = vec![0.0; second.batch * pixels * entries];
    out.par_chunks_mut((width * entries).max(1)).enumerate().for_each(|(row, out)| {
        let mut products = vec![0.0; windows.reach() * windows.reach()];
        for (x, out) in out.chunks_exact_mut(entries).enumerate() {
            let pixel = row * width + x;
            for (number, level) in second.levels.iter().enumerate() {
                let window = windows.window(pixel, number);
                products.fill(0.0);
                for (y, x) in window.inside(level) {
                    let at = window.feature(level, y, x.start);
                    let task = Dots {
                        first: windows.feature(pixel),
                        second: &level.features[at * second.channels..][..x.len() * second.channels],
                    };
                    let to = &mut products[y * windows.reach() + x.start..][..x.len()];
                    // SAFETY: `isa` is available.
                    unsafe { dots(isa, &task, to) }
                }
                let side = 2 * radius + 1;
                window.interpolate(
                    &products,
                    radius,
                    windows.scale,
                    &mut out[number * side * side..][..side * side],
                );
            }
        }
    });
    channels_first(&out, second.batch, entries)
}

/// Gradient of the first feature map (`[batch, height, width, channels]`) and of each level's features (likewise), from
/// `grad`, that of the window.
///
/// The positions get none: the networks detach them (`coords1.detach()` in the reference). Rows of the second image are
/// summed in the order of the first image's pixels, so the result does not depend on the number of threads.
pub fn correlation_lookup_backward(
    first: &[f32],
    second: &FeaturePyramid,
    coords: &[f32],
    [height, width]: [usize; 2],
    radius: usize,
    grad: &[f32],
) -> (Vec<f32>, Vec<Vec<f32>>) {
    let windows = Windows::new(first, second, coords, [height, width], radius);
    let (entries, reach, channels) = (windows.entries(), windows.reach(), second.channels);
    assert_eq!(grad.len(), second.batch * entries * height * width, "gradient of the window");
    let grad = channels_last(grad, second.batch, entries);
    let side = 2 * radius + 1;
    let pixels = second.batch * height * width;
    let mut d_first = vec![0.0; pixels * channels];
    let mut d_levels = Vec::new();
    for (number, level) in second.levels.iter().enumerate() {
        let mut d_products = vec![0.0; pixels * reach * reach];
        let d_pixels = d_products.par_chunks_mut(reach * reach).zip(d_first.par_chunks_mut(channels.max(1)));
        d_pixels.enumerate().for_each(|(pixel, (d_products, d_first))| {
            let window = windows.window(pixel, number);
            let grad = &grad[pixel * entries + number * side * side..][..side * side];
            window.spread(grad, radius, windows.scale, d_products);
            for (y, x) in window.inside(level) {
                for x in x {
                    let at = window.feature(level, y, x) * channels;
                    let weight = d_products[y * reach + x];
                    for (to, from) in d_first.iter_mut().zip(&level.features[at..at + channels]) {
                        *to += weight * from;
                    }
                }
            }
        });
        d_levels.push(windows.gather_second(number, level, &d_products));
    }
    (d_first, d_levels)
}

/// What all windows share.
struct Windows<'a> {
    first: &'a [f32],
    coords: &'a [f32],
    channels: usize,
    levels: usize,
    pixels: usize,
    radius: usize,
    /// `1 / sqrt(channels)`.
    scale: f32,
}

impl<'a> Windows<'a> {
    fn new(
        first: &'a [f32],
        second: &FeaturePyramid,
        coords: &'a [f32],
        [height, width]: [usize; 2],
        radius: usize,
    ) -> Self {
        let pixels = height * width;
        let (batch, channels) = (second.batch, second.channels);
        assert_eq!(first.len(), batch * channels * pixels, "features of {batch}x{channels}x{height}x{width}");
        assert_eq!(coords.len(), batch * 2 * pixels, "positions of {batch}x2x{height}x{width}");
        Self {
            first,
            coords,
            channels,
            levels: second.levels.len(),
            pixels,
            radius,
            scale: 1.0 / (channels as f32).sqrt(),
        }
    }

    fn entries(&self) -> usize {
        self.levels * (2 * self.radius + 1) * (2 * self.radius + 1)
    }

    /// Whole positions that a window needs in a row: one more than it has entries.
    fn reach(&self) -> usize {
        2 * self.radius + 2
    }

    fn feature(&self, pixel: usize) -> &[f32] {
        &self.first[pixel * self.channels..][..self.channels]
    }

    fn window(&self, pixel: usize, level: usize) -> Window {
        let (n, p) = (pixel / self.pixels, pixel % self.pixels);
        let scale = 1.0 / (1_u64 << level) as f32;
        let x = self.coords[2 * n * self.pixels + p] * scale;
        let y = self.coords[(2 * n + 1) * self.pixels + p] * scale;
        Window {
            image: n,
            // A cast saturates, and is 0 for NaN: any position is allowed.
            left: (x.floor() as i64).saturating_sub(self.radius as i64),
            top: (y.floor() as i64).saturating_sub(self.radius as i64),
            fraction_x: x - x.floor(),
            fraction_y: y - y.floor(),
            reach: self.reach(),
        }
    }

    /// Gradient of a level's features from that of the products of every pixel's window.
    fn gather_second(&self, number: usize, level: &Level, d_products: &[f32]) -> Vec<f32> {
        let row_len = (level.width * self.channels).max(1);
        let mut out = vec![0.0; level.features.len()];
        // Each thread owns a band of rows and passes over all windows.
        let bands = rayon::current_num_threads().max(1) * 4;
        let rows = (out.len() / row_len).div_ceil(bands).max(1);
        out.par_chunks_mut(rows * row_len).enumerate().for_each(|(band, out)| {
            let own = band * rows..band * rows + out.len() / row_len;
            for pixel in 0..d_products.len() / (self.reach() * self.reach()) {
                let window = self.window(pixel, number);
                for (y, xs) in window.inside(level) {
                    let row = window.feature(level, y, xs.start) / level.width;
                    if !own.contains(&row) {
                        continue;
                    }
                    for x in xs {
                        let at = (window.feature(level, y, x) - own.start * level.width) * self.channels;
                        let weight = d_products[(pixel * self.reach() + y) * self.reach() + x];
                        for (to, from) in out[at..at + self.channels].iter_mut().zip(self.feature(pixel)) {
                            *to += weight * from;
                        }
                    }
                }
            }
        });
        out
    }
}

/// The whole positions around one window of one level.
struct Window {
    image: usize,
    left: i64,
    top: i64,
    fraction_x: f32,
    fraction_y: f32,
    reach: usize,
}

impl Window {
    /// The rows, and in each the columns, of the window that lie inside the level.
    fn inside(&self, level: &Level) -> impl Iterator<Item = (usize, std::ops::Range<usize>)> + use<> {
        let within = |start: i64, size: usize, reach: usize| {
            let low = start.saturating_neg().clamp(0, reach as i64) as usize;
            let high = (size as i64).saturating_sub(start).clamp(0, reach as i64) as usize;
            low..high.max(low)
        };
        let columns = within(self.left, level.width, self.reach);
        let rows = within(self.top, level.height, self.reach);
        rows.filter(move |_| !columns.is_empty()).map({
            let columns = within(self.left, level.width, self.reach);
            move |row| (row, columns.clone())
        })
    }

    /// Number of the feature at a row and column of the window that lie inside the level.
    fn feature(&self, level: &Level, row: usize, column: usize) -> usize {
        let y = (self.top + row as i64) as usize;
        let x = (self.left + column as i64) as usize;
        (self.image * level.height + y) * level.width + x
    }

    fn weights(&self) -> [f32; 4] {
        let (x, y) = (self.fraction_x, self.fraction_y);
        [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y]
    }

    /// Bilinear samples of the products, in the order of the reference: x is the slower index.
    fn interpolate(&self, products: &[f32], radius: usize, scale: f32, out: &mut [f32]) {
        let [a, b, c, d] = self.weights().map(|w| w * scale);
        let side = 2 * radius + 1;
        for (i, out) in out.chunks_exact_mut(side).enumerate() {
            for (j, out) in out.iter_mut().enumerate() {
                let at = j * self.reach + i;
                let below = at + self.reach;
                *out =
                    a * products[at] + b * products[at + 1] + c * products[below] + d * products[below + 1];
            }
        }
    }

    /// The adjoint of [`Window::interpolate`].
    fn spread(&self, grad: &[f32], radius: usize, scale: f32, products: &mut [f32]) {
        let [a, b, c, d] = self.weights().map(|w| w * scale);
        let side = 2 * radius + 1;
        for (i, grad) in grad.chunks_exact(side).enumerate() {
            for (j, grad) in grad.iter().enumerate() {
                let at = j * self.reach + i;
                let below = at + self.reach;
                products[at] += a * grad;
                products[at + 1] += b * grad;
                products[below] += c * grad;
                products[below + 1] += d * grad;
            }
        }
    }
}

/// A feature of the first image and neighbouring features of the second.
struct Dots<'a> {
    first: &'a [f32],
    second: &'a [f32],
}

dispatch! {
    /// The dot product of `first` with each feature of `second`.
    ///
    /// # Safety
    /// `isa` is available.
    fn dots = dots_kernel(task: &Dots, out: &mut [f32])
}

#[inline(always)]
unsafe fn dots_kernel<S: Simd>(task: &Dots, out: &mut [f32]) {
    let channels = task.first.len();
    assert_eq!(task.second.len(), out.len() * channels);
    let mut done = 0;
    // SAFETY: the assertion above: `COUNT` features from `done` lie in `second`.
    unsafe {
        while out.len() - done >= 5 {
            dots_of::<S, 5>(task, done, out);
            done += 5;
        }
        while done < out.len() {
            dots_of::<S, 1>(task, done, out);
            done += 1;
        }
    }
}

#[inline(always)]
unsafe fn dots_of<S: Simd, const COUNT: usize>(task: &Dots, from: usize, out: &mut [f32]) {
    let channels = task.first.len();
    // SAFETY: the caller's promise.
    unsafe {
        let second = task.second.as_ptr().add(from * channels);
        let mut sums = [[S::splat(0.0); 2]; COUNT];
        let mut c = 0;
        let mut half = 0;
        while c < channels {
            let count = (channels - c).min(S::LANES);
            let load =
                |at: *const f32| if count == S::LANES { S::load(at) } else { S::load_first(at, count) };
            let a = load(task.first.as_ptr().add(c));
            for (i, sums) in sums.iter_mut().enumerate() {
                let b = load(second.add(i * channels + c));
                // Two chains of sums hide the latency of the fused multiply-add.
                if half == 0 {
                    sums[0] = S::mul_add(a, b, sums[0])
                } else {
                    sums[1] = S::mul_add(a, b, sums[1])
                }
            }
            half ^= 1;
            c += S::LANES;
        }
        for (i, sums) in sums.iter().enumerate() {
            out[from + i] = S::sum(S::add(sums[0], sums[1]));
        }
    }
}
