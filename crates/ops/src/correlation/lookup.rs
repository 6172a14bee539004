use std::ops::Range;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use srflow_simd::{
    Isa, Multiply, Numbers, Pair, Precision, Scratch, SharedMut, Simd, dispatch, dispatch_pairs, pair_up,
};

use super::FeaturePyramid;
use super::pyramid::{Level, channels_last};
use crate::precision::cpu_precision;

/// Window of the correlation pyramid around `coords`: `[batch, levels * (2 radius + 1)^2, height, width]`.
///
/// `first` is the feature map of the first image, `[batch, height, width, channels]`; `coords` are positions in the second
/// image, `[batch, 2, height, width]`, x then y, in pixels of the finest level. At the [`crate::precision()`]. Products are divided by `sqrt(channels)`;
/// outside the second image they are zero. The order of a window's entries is the reference's; see
/// [`super::reference::correlation_lookup`]. Panics when the length of a slice does not match.
pub fn correlation_lookup(
    first: &[f32],
    second: &FeaturePyramid,
    coords: &[f32],
    [height, width]: [usize; 2],
    radius: usize,
) -> Vec<f32> {
    let (isa, precision) = (Isa::best(), cpu_precision());
    lookup_with(isa, precision, first, second, &Paired::default(), coords, [height, width], radius)
}

/// The features of both images as [`Pair`]s of neighbouring channels, made at the first lookup that multiplies bfloat16.
#[derive(Debug, Clone, Default)]
pub(super) struct Paired {
    first: Arc<OnceLock<Vec<Pair>>>,
    /// Of each level.
    second: Arc<OnceLock<Vec<Vec<Pair>>>>,
}

impl Paired {
    /// Those of another first map and the same second one.
    pub(super) fn of_second(&self) -> Self {
        Self { first: Arc::default(), second: self.second.clone() }
    }
}

/// [`correlation_lookup`] with a chosen instruction set and precision. `kept` belongs to these features.
#[expect(clippy::too_many_arguments, reason = "those of the lookup, and how")]
pub(super) fn lookup_with(
    isa: Isa,
    precision: Precision,
    first: &[f32],
    second: &FeaturePyramid,
    kept: &Paired,
    coords: &[f32],
    [height, width]: [usize; 2],
    radius: usize,
) -> Vec<f32> {
    let windows = Windows::new(first, second, coords, [height, width], radius);
    let paired = precision == Precision::Bf16 && second.channels.is_multiple_of(2);
    let levels = second.levels.iter().map(|level| &*level.features);
    let features = if paired {
        let levels = || levels.map(pairs).collect();
        Features::Pairs {
            first: kept.first.get_or_init(|| pairs(first)),
            levels: kept.second.get_or_init(levels),
        }
    } else {
        Features::Numbers { first, levels: levels.collect() }
    };
    let entries = windows.entries();
    let pixels = height * width;
    let fill = |out: SharedMut| {
        let scratch = || (Scratch::of(width * entries), Vec::new());
        (0..second.batch * height).into_par_iter().for_each_init(
            scratch,
            |(windows_of_row, products), row| {
                for group in (0..width).step_by(GROUP) {
                    let first = row * width + group;
                    let count = GROUP.min(width - group);
                    for number in 0..second.levels.len() {
                        let windows_of_group =
                            [0, 1, 2, 3].map(|i| windows.window(first + i.min(count - 1), number));
                        // Neighbours mostly have nearly the same window, and can share loads.
                        let common = Common::of(&windows_of_group);
                        let together = if common.is_small() { count } else { 1 };
                        for start in (0..count).step_by(together) {
                            let of = &windows_of_group[start..start + together];
                            let common = Common::of(of);
                            let pixels = first + start..first + start + together;
                            common.products(isa, &features, second, number, pixels, products);
                            for (i, window) in of.iter().enumerate() {
                                let side = windows.side();
                                let at = (group + start + i) * entries + number * side * side;
                                let products = &products[i * common.len()..][common.offset(window)..];
                                let out = &mut windows_of_row[at..at + side * side];
                                window.interpolate(products, common.columns, windows.scale, out);
                            }
                        }
                    }
                }
                let (n, y) = (row / height, row % height);
                // SAFETY: this row of every entry is this task's.
                unsafe { put_row(windows_of_row, &out, n * entries * pixels + y * width, [entries, pixels]) }
            },
        );
    };
    // SAFETY: each task writes its row of all entries.
    unsafe { SharedMut::fill_new(second.batch * pixels * entries, fill) }
}

/// Writes the entries of a row's pixels, `[width, entries]`, to a row of each entry's plane; the first begins at element `first`, and
/// planes are `pixels` elements apart.
///
/// # Safety
/// The row of each plane belongs to the calling task alone.
unsafe fn put_row(from: &[f32], out: &SharedMut, first: usize, [entries, pixels]: [usize; 2]) {
    /// As many numbers as a line of the cache has.
    const BLOCK: usize = 16;
    let width = from.len() / entries;
    for start in (0..entries).step_by(BLOCK) {
        let block = BLOCK.min(entries - start);
        // Both ends are checked to lie in the output.
        let to = out.at(first + start * pixels);
        out.at(first + (start + block - 1) * pixels + width - 1);
        for (x, from) in from.chunks_exact(entries).enumerate() {
            for (entry, &value) in from[start..start + block].iter().enumerate() {
                // SAFETY: inside, and of this task.
                unsafe { to.add(entry * pixels + x).write(value) }
            }
        }
    }
}

/// What is multiplied: the features of the first image, and of each level of the second.
enum Features<'a> {
    Numbers { first: &'a [f32], levels: Vec<&'a [f32]> },
    Pairs { first: &'a [Pair], levels: &'a [Vec<Pair>] },
}

/// Neighbouring channels as pairs; there is an even number of them.
fn pairs(features: &[f32]) -> Vec<Pair> {
    const PIECE: usize = 1 << 14;
    let mut pairs = vec![Pair::default(); features.len() / 2];
    let pieces = pairs.par_chunks_mut(PIECE).zip(features.par_chunks(2 * PIECE));
    pieces.for_each(|(pairs, features)| pair_up(features, pairs));
    pairs
}

/// Neighbouring pixels whose windows are looked up together.
const GROUP: usize = 4;
/// Extra rows and columns that the union of a group's windows may have.
const SPREAD: usize = 4;

/// The bounding rectangle of several windows of one level.
struct Common {
    image: usize,
    left: i64,
    top: i64,
    columns: usize,
    rows: usize,
    reach: usize,
}

impl Common {
    fn of(windows: &[Window]) -> Self {
        let extent = |start: fn(&Window) -> i64| {
            let least = windows.iter().map(start).min().unwrap_or(0);
            let most = windows.iter().map(start).max().unwrap_or(0);
            (least, most.saturating_sub(least) as usize)
        };
        let ((left, wider), (top, higher)) = (extent(|window| window.left), extent(|window| window.top));
        let reach = windows[0].reach;
        let (columns, rows) = (reach.saturating_add(wider), reach.saturating_add(higher));
        Self { image: windows[0].image, left, top, columns, rows, reach }
    }

    fn is_small(&self) -> bool {
        self.columns.max(self.rows) <= self.reach + SPREAD
    }

    fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Offset of a window's first product in the rectangle.
    fn offset(&self, window: &Window) -> usize {
        (window.top - self.top) as usize * self.columns + (window.left - self.left) as usize
    }

    /// The products of `pixels`, one rectangle after another, zero outside the level of a number.
    fn products(
        &self,
        isa: Isa,
        features: &Features,
        second: &FeaturePyramid,
        number: usize,
        pixels: Range<usize>,
        products: &mut Vec<f32>,
    ) {
        let level = &second.levels[number];
        products.clear();
        products.resize(pixels.len() * self.len(), 0.0);
        let columns = within(self.left, level.width, self.columns);
        for row in within(self.top, level.height, self.rows) {
            if columns.is_empty() {
                return;
            }
            let y = (self.top + row as i64) as usize;
            let x = (self.left + columns.start as i64) as usize;
            let at = (self.image * level.height + y) * level.width + x;
            let out = &mut products[row * self.columns + columns.start..];
            let of = [pixels.clone(), at..at + columns.len()];
            match features {
                Features::Numbers { first, levels } => {
                    dots(isa, &Dots::new(first, levels[number], of, second.channels, self.len()), out);
                }
                Features::Pairs { first, levels } => {
                    let task = Dots::new(first, &levels[number], of, second.channels / 2, self.len());
                    dots_of_pairs(isa, &task, out);
                }
            }
        }
    }
}

/// The positions among `reach` from `start` on that lie inside `size`.
fn within(start: i64, size: usize, reach: usize) -> std::ops::Range<usize> {
    let low = start.saturating_neg().clamp(0, reach as i64) as usize;
    let high = (size as i64).saturating_sub(start).clamp(0, reach as i64) as usize;
    low..high.max(low)
}

/// Gradients of the first feature map (`[batch, height, width, channels]`) and of each level's features (likewise), given
/// `grad`, that of the window.
///
/// The positions have no gradient: the networks detach them (`coords1.detach()` in the reference). Rows of the second image are
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

/// Data shared by all windows.
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

    /// Number of entries in a row of a window.
    fn side(&self) -> usize {
        2 * self.radius + 1
    }

    /// Number of integer positions in a row of a window: one more than entries.
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
            // A cast saturates, and NaN becomes 0: any position is allowed.
            left: (x.floor() as i64).saturating_sub(self.radius as i64),
            top: (y.floor() as i64).saturating_sub(self.radius as i64),
            fraction_x: x - x.floor(),
            fraction_y: y - y.floor(),
            reach: self.reach(),
        }
    }

    /// Gradient of a level's features, given that of the products of every pixel's window.
    fn gather_second(&self, number: usize, level: &Level, d_products: &[f32]) -> Vec<f32> {
        let row_len = (level.width * self.channels).max(1);
        let mut out = vec![0.0; level.features.len()];
        // Each thread owns a band of rows and iterates over all windows.
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

/// The integer positions of one window of one level.
struct Window {
    image: usize,
    left: i64,
    top: i64,
    fraction_x: f32,
    fraction_y: f32,
    reach: usize,
}

impl Window {
    /// The rows and columns of the window that lie inside the level.
    fn inside(&self, level: &Level) -> impl Iterator<Item = (usize, std::ops::Range<usize>)> + use<> {
        let columns = within(self.left, level.width, self.reach);
        let rows = within(self.top, level.height, self.reach);
        rows.filter(move |_| !columns.is_empty()).map({
            let columns = within(self.left, level.width, self.reach);
            move |row| (row, columns.clone())
        })
    }

    /// Index of the feature at a row and column of the window, which must lie inside the level.
    fn feature(&self, level: &Level, row: usize, column: usize) -> usize {
        let y = (self.top + row as i64) as usize;
        let x = (self.left + column as i64) as usize;
        (self.image * level.height + y) * level.width + x
    }

    fn weights(&self) -> [f32; 4] {
        let (x, y) = (self.fraction_x, self.fraction_y);
        [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y]
    }

    /// Bilinear samples of the products, whose rows are `step` elements apart, in the reference's order: x is the slower index.
    fn interpolate(&self, products: &[f32], step: usize, scale: f32, out: &mut [f32]) {
        let [a, b, c, d] = self.weights().map(|w| w * scale);
        for (i, out) in out.chunks_exact_mut(self.reach - 1).enumerate() {
            for (j, out) in out.iter_mut().enumerate() {
                let at = j * step + i;
                let below = at + step;
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

/// Features of neighbouring pixels of the first image, and of the second: numbers, or [`Pair`]s of them.
struct Dots<'a, E> {
    first: &'a [E],
    second: &'a [E],
    /// Elements of a pixel.
    channels: usize,
    /// From the products of one pixel of the first image to those of the next.
    step: usize,
}

impl<'a, E> Dots<'a, E> {
    /// Of ranges of pixels.
    fn new(first: &'a [E], second: &'a [E], pixels: [Range<usize>; 2], channels: usize, step: usize) -> Self {
        let [first, second] = [(first, &pixels[0]), (second, &pixels[1])]
            .map(|(features, pixels)| &features[pixels.start * channels..pixels.end * channels]);
        Self { first, second, channels, step }
    }

    /// Panics when the products of some pixels do not fit.
    fn check(&self, out: &[f32]) {
        let [pixels, positions] = [self.first, self.second].map(|features| features.len() / self.channels);
        assert!(pixels > 0 && out.len() >= (pixels - 1) * self.step + positions);
    }

    fn addresses(&self) -> Addresses {
        let [pixels, positions] = [self.first, self.second].map(|features| features.len() / self.channels);
        let (first, second) = (self.first.as_ptr().cast(), self.second.as_ptr().cast());
        Addresses { first, second, pixels, positions, channels: self.channels, step: self.step }
    }
}

/// [`Dots`] whose elements the kernel knows.
struct Addresses {
    first: *const f32,
    second: *const f32,
    pixels: usize,
    positions: usize,
    channels: usize,
    step: usize,
}

/// The dot product of each feature of `first` with each of `second`.
fn dots(isa: Isa, task: &Dots<f32>, out: &mut [f32]) {
    task.check(out);
    // SAFETY: the products fit, and the features are as many as the slices hold.
    unsafe { dots_unchecked(isa, &task.addresses(), out) }
}

/// [`dots`] of pairs.
fn dots_of_pairs(isa: Isa, task: &Dots<Pair>, out: &mut [f32]) {
    task.check(out);
    // SAFETY: as above; a pair has the size and alignment of an `f32`.
    unsafe { dots_of_pairs_unchecked(isa, &task.addresses(), out) }
}

dispatch! {
    /// # Safety
    /// The addresses are those of [`Dots`] whose products fit.
    unsafe fn dots_unchecked = dots_of_numbers(task: &Addresses, out: &mut [f32])
}

dispatch_pairs! {
    /// # Safety
    /// As for [`dots_unchecked`], of pairs.
    unsafe fn dots_of_pairs_unchecked = dots_kernel(task: &Addresses, out: &mut [f32])
}

#[inline(always)]
unsafe fn dots_of_numbers<S: Simd>(s: S, task: &Addresses, out: &mut [f32]) {
    // SAFETY: guaranteed by the caller.
    unsafe { dots_kernel(s, Numbers, task, out) }
}

#[inline(always)]
unsafe fn dots_kernel<S: Simd, M: Multiply<S>>(s: S, how: M, task: &Addresses, out: &mut [f32]) {
    let Addresses { pixels, positions, .. } = *task;
    let mut done = 0;
    // SAFETY: guaranteed by the caller: `COUNT` features from `done` on lie in `second`, `PIXELS` in `first`.
    unsafe {
        if pixels == GROUP {
            while positions - done >= 4 {
                dots_of::<S, M, GROUP, 4>(s, how, task, 0, done, out);
                done += 4;
            }
            while done < positions {
                dots_of::<S, M, GROUP, 1>(s, how, task, 0, done, out);
                done += 1;
            }
            return;
        }
        for pixel in 0..pixels {
            done = 0;
            while positions - done >= 8 {
                dots_of::<S, M, 1, 8>(s, how, task, pixel, done, out);
                done += 8;
            }
            while done < positions {
                dots_of::<S, M, 1, 1>(s, how, task, pixel, done, out);
                done += 1;
            }
        }
    }
}

#[inline(always)]
unsafe fn dots_of<S: Simd, M: Multiply<S>, const PIXELS: usize, const COUNT: usize>(
    s: S,
    how: M,
    task: &Addresses,
    pixel: usize,
    from: usize,
    out: &mut [f32],
) {
    let channels = task.channels;
    // SAFETY: guaranteed by the caller.
    unsafe {
        let first = task.first.add(pixel * channels);
        let second = task.second.add(from * channels);
        let mut sums = [[s.splat(0.0); COUNT]; PIXELS];
        let mut c = 0;
        while c + S::LANES <= channels {
            let mut features = [s.splat(0.0); COUNT];
            for i in 0..COUNT {
                features[i] = s.load(second.add(i * channels + c));
            }
            for p in 0..PIXELS {
                let a = s.load(first.add(p * channels + c));
                for i in 0..COUNT {
                    sums[p][i] = how.add(s, a, features[i], sums[p][i]);
                }
            }
            c += S::LANES;
        }
        if c < channels {
            let count = channels - c;
            for p in 0..PIXELS {
                let a = s.load_first(first.add(p * channels + c), count);
                for i in 0..COUNT {
                    let feature = s.load_first(second.add(i * channels + c), count);
                    sums[p][i] = how.add(s, a, feature, sums[p][i]);
                }
            }
        }
        for p in 0..PIXELS {
            for i in 0..COUNT {
                out[(pixel + p) * task.step + from + i] = s.sum(sums[p][i]);
            }
        }
    }
}
