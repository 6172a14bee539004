//! The definition of the loss between pictures, in `f64`, window by window.

use srflow_core::Size;

use super::ImageLossValue;

/// Constants of SSIM, for values in 0..1 (Wang et al. 2004).
pub const C1: f64 = 0.01 * 0.01;
/// See [`C1`].
pub const C2: f64 = 0.03 * 0.03;
/// Pixels from the window's centre to its border.
pub const RADIUS: usize = 5;
/// Pixels of a side of the window.
pub const WINDOW_LEN: usize = 2 * RADIUS + 1;

/// The window along one axis: a Gaussian of standard deviation 1.5, whose sum is 1.
pub fn window() -> [f64; WINDOW_LEN] {
    let gaussian: [f64; WINDOW_LEN] = std::array::from_fn(|i| {
        let offset = i as f64 - RADIUS as f64;
        libm::exp(-offset * offset / (2.0 * 1.5 * 1.5))
    });
    let sum: f64 = gaussian.iter().sum();
    gaussian.map(|weight| weight / sum)
}

/// The loss of a rendered picture, as [`ImageLoss`](super::ImageLoss) describes it, and its gradient. Both pictures have
/// this size, or it panics.
pub fn loss(
    rendered: &[[f64; 3]],
    target: &[[f64; 3]],
    size: Size,
    ssim_weight: f64,
) -> (ImageLossValue, Vec<[f64; 3]>) {
    let Size { width, height } = size;
    let numbers = 3.0 * size.pixels() as f64;
    let mut value = ImageLossValue::default();
    let mut gradient = vec![[0.0; 3]; size.pixels()];
    let window = window();
    // The pixels under the window at (x, y), with their weights.
    let under = |x: usize, y: usize| {
        let rows = y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height);
        rows.flat_map(move |row| {
            let columns = x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width);
            columns.map(move |column| {
                (row * width + column, window[column + RADIUS - x] * window[row + RADIUS - y])
            })
        })
    };
    for channel in 0..3 {
        for (at, (rendered, target)) in rendered.iter().zip(target).enumerate() {
            let difference = rendered[channel] - target[channel];
            value.l1 += difference.abs() / numbers;
            let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
            gradient[at][channel] += (1.0 - ssim_weight) * sign / numbers;
        }
        for y in 0..height {
            for x in 0..width {
                let (mut mean_a, mut mean_b, mut square_a, mut square_b, mut product) =
                    (0.0, 0.0, 0.0, 0.0, 0.0);
                for (at, weight) in under(x, y) {
                    let (a, b) = (rendered[at][channel], target[at][channel]);
                    mean_a += weight * a;
                    mean_b += weight * b;
                    square_a += weight * a * a;
                    square_b += weight * b * b;
                    product += weight * a * b;
                }
                let a1 = 2.0 * mean_a * mean_b + C1;
                let a2 = 2.0 * (product - mean_a * mean_b) + C2;
                let b1 = mean_a * mean_a + mean_b * mean_b + C1;
                let b2 = square_a - mean_a * mean_a + square_b - mean_b * mean_b + C2;
                let similarity = a1 * a2 / (b1 * b2);
                value.ssim += similarity / numbers;
                let by_square = -similarity / b2;
                let by_product = 2.0 * a1 / (b1 * b2);
                let by_mean =
                    2.0 * mean_b * (a2 - a1) / (b1 * b2) + 2.0 * mean_a * similarity * (1.0 / b2 - 1.0 / b1);
                for (at, weight) in under(x, y) {
                    let (a, b) = (rendered[at][channel], target[at][channel]);
                    let slope = by_mean + 2.0 * a * by_square + b * by_product;
                    gradient[at][channel] -= ssim_weight * weight * slope / numbers;
                }
            }
        }
    }
    value.total = (1.0 - ssim_weight) * value.l1 + ssim_weight * (1.0 - value.ssim);
    (value, gradient)
}
