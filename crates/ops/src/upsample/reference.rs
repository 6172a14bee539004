//! The definition, in f64.

use super::{NEIGHBOURS, UpsampleShape};

/// See [`super::convex_upsample`].
pub fn convex_upsample(flow: &[f32], mask: &[f32], scale: f32, shape: &UpsampleShape) -> Vec<f32> {
    let UpsampleShape { batch, coarse: [height, width], factor } = *shape;
    let pixels = height * width;
    let mut out = vec![0.0; shape.output_len()];
    for n in 0..batch {
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            for (i, j) in (0..factor).flat_map(|i| (0..factor).map(move |j| (i, j))) {
                let exponentials: Vec<f64> = (0..NEIGHBOURS)
                    .map(|k| {
                        let channel = (n * NEIGHBOURS + k) * factor * factor + i * factor + j;
                        (f64::from(scale) * f64::from(mask[channel * pixels + y * width + x])).exp()
                    })
                    .collect();
                let total: f64 = exponentials.iter().sum();
                for c in 0..2 {
                    let at = |pixel: usize| f64::from(flow[(n * 2 + c) * pixels + pixel]);
                    let sum: f64 = (0..NEIGHBOURS)
                        .map(|k| exponentials[k] / total * shape.neighbour(y, x, k).map_or(0.0, at))
                        .sum();
                    let row = ((n * 2 + c) * height + y) * factor + i;
                    out[row * width * factor + x * factor + j] = (sum * factor as f64) as f32;
                }
            }
        }
    }
    out
}
