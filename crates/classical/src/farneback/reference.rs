//! The kernels of the method as plain scalar code over the whole image: the fast kernels must match them bit for bit.

use srflow_core::{Plane, Size};

use super::evidence::border_weight;
use super::expansion::ExpansionKernel;
use super::pyramid::mirror;
use super::window::{Weighting, Window};
use crate::planar::PlanarFlow;

/// Separable convolution with a symmetric kernel, fused except in the remainder columns of vectors of 8.
pub fn blur(frame: &Plane, kernel: &[f32]) -> Plane {
    let Size { width, height } = frame.size();
    let radius = kernel.len() / 2;
    let short = kernel.len() <= 5;
    let multiply_add = |x: usize, value: f32, weight: f32, sum: f32| {
        if short || x < width - width % 8 { value.mul_add(weight, sum) } else { value * weight + sum }
    };
    let across = Plane::from_fn(width, height, |x, y| {
        let at = |i: usize| frame.get(mirror((x + i) as isize - radius as isize, width), y);
        if short {
            let outer = (at(0) + at(2 * radius)) * kernel[0];
            let pairs =
                (1..radius).fold(outer, |sum, i| (at(i) + at(2 * radius - i)).mul_add(kernel[i], sum));
            at(radius).mul_add(kernel[radius], pairs)
        } else {
            kernel.iter().enumerate().fold(0.0, |sum, (i, weight)| multiply_add(x, at(i), *weight, sum))
        }
    });
    Plane::from_fn(width, height, |x, y| {
        let at = |offset: isize| across.get(x, mirror(y as isize + offset, height));
        (1..=radius).fold(at(0) * kernel[radius], |sum, i| {
            multiply_add(x, at(-(i as isize)) + at(i as isize), kernel[radius + i], sum)
        })
    })
}

/// The fit at every pixel of `image`, row-major: `b_x`, `b_y`, `A_xx`, `A_yy`, `2 A_xy`.
pub fn expand(image: &Plane, kernel: &ExpansionKernel) -> Vec<[f32; 5]> {
    let Size { width, height } = image.size();
    let inverse = &kernel.inverse;
    let mut fits = Vec::with_capacity(width * height);
    for y in 0..height {
        let down: Vec<[f32; 3]> = (0..width)
            .map(|x| {
                let mut moments = [image.get(x, y) * kernel.g[0][0], 0.0, 0.0];
                for (k, g) in (1..).zip(&kernel.g[1..]) {
                    let (above, below) =
                        (image.get(x, y.saturating_sub(k)), image.get(x, (y + k).min(height - 1)));
                    moments[0] += g[0] * (above + below);
                    moments[1] += g[1] * (below - above);
                    moments[2] += g[2] * (above + below);
                }
                moments
            })
            .collect();
        for x in 0..width {
            let [mut one, mut of_y, mut of_yy] = down[x].map(|moment| f64::from(moment * kernel.g[0][0]));
            let [mut of_x, mut of_xx, mut of_xy] = [0.0_f64; 3];
            for (k, g) in (1..).zip(&kernel.g[1..]) {
                let (left, right) = (down[x.saturating_sub(k)], down[(x + k).min(width - 1)]);
                let sum = f64::from(right[0] + left[0]);
                one += sum * f64::from(g[0]);
                of_xx += sum * f64::from(g[2]);
                of_x += f64::from((right[0] - left[0]) * g[1]);
                of_y += f64::from((right[1] + left[1]) * g[0]);
                of_xy += f64::from((right[1] - left[1]) * g[1]);
                of_yy += f64::from((right[2] + left[2]) * g[0]);
            }
            fits.push([
                (of_x * inverse.linear) as f32,
                (of_y * inverse.linear) as f32,
                (one * inverse.constant_square + of_xx * inverse.square) as f32,
                (one * inverse.constant_square + of_yy * inverse.square) as f32,
                (of_xy * inverse.mixed) as f32,
            ]);
        }
    }
    fits
}

/// The normal equations `G d = h` of one pixel: `G_yy`, `G_xy`, `G_xx`, `h_y`, `h_x`.
type Evidence = [f32; 5];

/// One iteration: a new flow from the fits of both frames and the flow so far.
pub fn update(first: &[[f32; 5]], second: &[[f32; 5]], flow: &PlanarFlow, window: &Window) -> PlanarFlow {
    let size = flow.u.size();
    let evidence: Vec<Evidence> = (0..size.pixels())
        .map(|i| {
            let (x, y) = (i % size.width, i / size.width);
            compare_fits(first[i], second, size, (x, y), [flow.u.get(x, y), flow.v.get(x, y)])
        })
        .collect();
    let mut updated = PlanarFlow::zero(size.width, size.height);
    for (i, [g_yy, g_xy, g_xx, h_y, h_x]) in average(&evidence, size, window).into_iter().enumerate() {
        let inverse = 1.0 / (g_yy * g_xx - g_xy * g_xy + 1e-3);
        updated.u.pixels_mut()[i] = ((g_yy * h_x - g_xy * h_y) * inverse) as f32;
        updated.v.pixels_mut()[i] = ((g_xx * h_y - g_xy * h_x) * inverse) as f32;
    }
    updated
}

/// Compares the fit at a pixel of the first frame with the fit of the second frame at the position the flow points to.
fn compare_fits(
    [x1, y1, xx1, yy1, xy1]: [f32; 5],
    second: &[[f32; 5]],
    Size { width, height }: Size,
    (x, y): (usize, usize),
    [u, v]: [f32; 2],
) -> Evidence {
    let (target_x, target_y) = (x as f32 + u, y as f32 + v);
    let (left, top) = (target_x.floor(), target_y.floor());
    let inside = left >= 0.0 && top >= 0.0 && left + 1.0 < width as f32 && top + 1.0 < height as f32;
    let [mut xx, mut yy, mut xy, mut dx, mut dy] = [xx1, yy1, xy1 * 0.5, x1 * 0.5, y1 * 0.5];
    if inside {
        let (fx, fy) = (target_x - left, target_y - top);
        let at = top as usize * width + left as usize;
        let corners = [second[at], second[at + 1], second[at + width], second[at + width + 1]];
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        let [x2, y2, xx2, yy2, xy2] = [0, 1, 2, 3, 4].map(|coefficient| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|corner| weights[corner] * corners[corner][coefficient]);
            a + b + c + d
        });
        xx = (xx1 + xx2) * 0.5;
        yy = (yy1 + yy2) * 0.5;
        xy = (xy1 + xy2) * 0.25;
        dx = (x1 - x2) * 0.5;
        dy = (y1 - y2) * 0.5;
    }
    dx += xx * u + xy * v;
    dy += yy * v + xy * u;
    let weight = border_weight(x, width) * border_weight(y, height);
    let [xx, yy, xy, dx, dy] = [xx, yy, xy, dx, dy].map(|value| value * weight);
    [yy * yy + xy * xy, (yy + xx) * xy, xx * xx + xy * xy, yy * dy + xy * dx, xy * dy + xx * dx]
}

/// The average over the window around every pixel; outside the image the border is repeated.
fn average(evidence: &[Evidence], size: Size, window: &Window) -> Vec<[f64; 5]> {
    let (Size { width, height }, radius) = (size, window.radius);
    match &window.weighting {
        Weighting::Box { scale } => {
            let down = column_sums(evidence, size, radius);
            let at = |y: usize, i: usize, channel: usize| {
                down[y * width + i.saturating_sub(radius).min(width - 1)][channel]
            };
            (0..size.pixels())
                .map(|i| {
                    let (x, y) = (i % width, i / width);
                    [0, 1, 2, 3, 4].map(|c| scale * sum_of_powers(&|i| at(y, i, c), x, 2 * radius + 1))
                })
                .collect()
        }
        Weighting::Gaussian { weights } => {
            let weighted = |centre: usize, len: usize, at: &dyn Fn(usize) -> Evidence| {
                [0, 1, 2, 3, 4].map(|c| {
                    (1..=radius).fold(at(centre)[c] * weights[0], |sum, k| {
                        let (before, after) = (at(centre.saturating_sub(k)), at((centre + k).min(len - 1)));
                        sum + (before[c] + after[c]) * weights[k]
                    })
                })
            };
            let down: Vec<Evidence> = (0..size.pixels())
                .map(|i| weighted(i / width, height, &|y| evidence[y * width + i % width]))
                .collect();
            (0..size.pixels())
                .map(|i| weighted(i % width, width, &|x| down[i / width * width + x]).map(f64::from))
                .collect()
        }
    }
}

/// Sums down each column of the window around each row. The window slides: the row that leaves is subtracted and the row
/// that enters is added, as one difference in single precision.
fn column_sums(evidence: &[Evidence], Size { width, height }: Size, radius: usize) -> Vec<[f64; 5]> {
    let mut all = vec![[0.0; 5]; width * height];
    for x in 0..width {
        let row = |y: usize| evidence[y.min(height - 1) * width + x];
        let mut sums = row(0).map(|value| f64::from(value * (radius + 2) as f32));
        for y in 1..radius {
            (0..5).for_each(|c| sums[c] += f64::from(row(y)[c]));
        }
        for y in 0..height {
            let (added, removed) = (row(y + radius), row(y.saturating_sub(radius + 1)));
            (0..5).for_each(|c| sums[c] += f64::from(added[c] - removed[c]));
            all[y * width + x] = sums;
        }
    }
    all
}

/// The sum of `len` values from `start` on: pairwise within the largest power of two, then the rest.
fn sum_of_powers(at: &dyn Fn(usize) -> f64, start: usize, len: usize) -> f64 {
    if len == 1 {
        return at(start);
    }
    let power = if len.is_power_of_two() { len / 2 } else { 1 << len.ilog2() };
    sum_of_powers(at, start, power) + sum_of_powers(at, start + power, len - power)
}

mod tests {
    use srflow_core::random::Key;

    use super::super::expansion::{COEFFICIENTS, Expansion};
    use super::super::pyramid;
    use super::super::update::iterate;
    use super::*;

    fn noise(width: usize, height: usize, name: &str) -> Plane {
        let mut random = Key::new(3).stream(name);
        Plane::from_fn(width, height, |_, _| random.below(256) as f32)
    }

    fn bits(values: &[f32]) -> Vec<u32> {
        values.iter().map(|value| value.to_bits()).collect()
    }

    #[test]
    fn the_fast_blur_matches() {
        for (width, height) in [(1, 1), (5, 40), (150, 31), (131, 7)] {
            let frame = noise(width, height, "frame");
            for scale in [1.0, 0.5, 0.4, 0.25, 1.0 / 32.0] {
                let kernel = pyramid::blur_kernel(scale);
                let (fast, plain) = (pyramid::blur(&frame, &kernel), blur(&frame, &kernel));
                assert_eq!(
                    bits(fast.pixels()),
                    bits(plain.pixels()),
                    "{width}x{height}, {} taps",
                    kernel.len()
                );
            }
        }
    }

    #[test]
    fn the_fast_expansion_matches() {
        for (width, height) in [(1, 1), (5, 40), (150, 31), (16, 7)] {
            let image = noise(width, height, "frame");
            for (radius, sigma) in [(5, 1.1), (7, 1.5), (1, 0.0), (20, 6.0)] {
                let kernel = ExpansionKernel::new(radius, sigma).unwrap();
                let (fast, plain) = (Expansion::of(&image, &kernel), expand(&image, &kernel));
                let fast = &fast.coefficients[..width * height * COEFFICIENTS];
                assert_eq!(bits(fast), bits(plain.as_flattened()), "{width}x{height}, radius {radius}");
            }
        }
    }

    #[test]
    fn the_fast_update_matches() {
        let kernel = ExpansionKernel::new(5, 1.1).unwrap();
        for (width, height) in [(1, 1), (1, 30), (40, 1), (5, 40), (331, 47)] {
            let (first, second) = (noise(width, height, "first"), noise(width, height, "second"));
            let plain = (expand(&first, &kernel), expand(&second, &kernel));
            let fast = (Expansion::of(&first, &kernel), Expansion::of(&second, &kernel));
            let mut random = Key::new(4).stream("flow");
            let mut flow = PlanarFlow::zero(width, height);
            flow.u.pixels_mut().iter_mut().for_each(|u| *u = 20.0 * random.normal());
            flow.v.pixels_mut().iter_mut().for_each(|v| *v = 3.0 * random.normal());
            for (winsize, gaussian) in
                [(13, false), (2, false), (30, false), (200, false), (13, true), (100, true)]
            {
                let window = Window::new(winsize, gaussian);
                let expected =
                    update(&plain.0, &plain.1, &update(&plain.0, &plain.1, &flow, &window), &window);
                let found = iterate((&fast.0, &fast.1), &flow, &window, 2);
                let what = format!("{width}x{height}, window {winsize}, gaussian {gaussian}");
                assert_eq!(bits(found.u.pixels()), bits(expected.u.pixels()), "u, {what}");
                assert_eq!(bits(found.v.pixels()), bits(expected.v.pixels()), "v, {what}");
            }
        }
    }
}
