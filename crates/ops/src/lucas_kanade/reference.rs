//! The definition: Lucas and Kanade, *An iterative image registration technique*, 1981, with both squared slopes raised by the
//! variance of noise.

use super::{CELL, LucasKanade, PER_WINDOW, in_cells};
use crate::MapShape;

/// See [`LucasKanade::forward`].
pub fn forward(of: &LucasKanade, first: &[f64], second: &[f64], shape: MapShape) -> Vec<f64> {
    let MapShape { batch, channels, height, width } = shape;
    let cells = in_cells(shape);
    // Brightness, beyond the border that of the nearest pixel.
    let brightness = |frames: &[f64], n: usize, y: isize, x: isize| {
        let y = y.clamp(0, height as isize - 1) as usize;
        let x = x.clamp(0, width as isize - 1) as usize;
        let of = |channel: usize| frames[((n * channels + channel) * height + y) * width + x];
        (0..channels).map(of).sum::<f64>() / channels as f64
    };
    let products = |n: usize, y: isize, x: isize| {
        let mean = |y, x| (brightness(first, n, y, x) + brightness(second, n, y, x)) / 2.0;
        let dx = (mean(y, x + 1) - mean(y, x - 1)) / 2.0;
        let dy = (mean(y + 1, x) - mean(y - 1, x)) / 2.0;
        let dt = brightness(second, n, y, x) - brightness(first, n, y, x);
        [dx * dx, dx * dy, dy * dy, dx * dt, dy * dt]
    };
    let (noise, reach) = (f64::from(of.noise), f64::from(of.reach));
    let mut out = vec![0.0; cells.elements()];
    for (n, (window, radius)) in
        (0..batch).flat_map(|n| of.radii.into_iter().enumerate().map(move |r| (n, r)))
    {
        for (y, x) in (0..cells.height).flat_map(|y| (0..cells.width).map(move |x| (y, x))) {
            let pixels =
                |i: usize, size: usize| CELL * i.saturating_sub(radius)..(CELL * (i + radius + 1)).min(size);
            let (rows, columns) = (pixels(y, height), pixels(x, width));
            let count = (rows.len() * columns.len()) as f64;
            let mut sums = [0.0; 5];
            for (y, x) in rows.flat_map(|y| columns.clone().map(move |x| (y, x))) {
                let products = products(n, y as isize, x as isize);
                sums.iter_mut().zip(products).for_each(|(sum, product)| *sum += product / count);
            }
            let [xx, xy, yy, xt, yt] = sums;
            // Of the system [[xx, xy], [xy, yy]] [u, v] = -[xt, yt].
            let (noisy_xx, noisy_yy) = (xx + noise, yy + noise);
            let determinant = noisy_xx * noisy_yy - xy * xy;
            let u = (xy * yt - noisy_yy * xt) / determinant;
            let v = (xy * xt - noisy_xx * yt) / determinant;
            let found = [u.clamp(-reach, reach), v.clamp(-reach, reach), xx / noisy_xx, yy / noisy_yy];
            for (output, found) in found.into_iter().enumerate() {
                let plane = n * cells.channels + window * PER_WINDOW + output;
                out[(plane * cells.height + y) * cells.width + x] = found;
            }
        }
    }
    out
}
