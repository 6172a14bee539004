//! The definition, in f64.

use super::WarpShape;

/// See [`super::warp`].
pub fn warp(image: &[f32], flow: &[f32], shape: &WarpShape) -> Vec<f32> {
    let WarpShape { batch, channels, size: [height, width] } = *shape;
    let pixels = height * width;
    let mut out = Vec::with_capacity(image.len());
    for plane in 0..batch * channels {
        let n = plane / channels;
        for at in 0..pixels {
            let x = (at % width) as f64 + f64::from(flow[n * 2 * pixels + at]);
            let y = (at / width) as f64 + f64::from(flow[(n * 2 + 1) * pixels + at]);
            let mut sum = 0.0;
            for row in 0..height {
                for column in 0..width {
                    let weight =
                        (1.0 - (x - column as f64).abs()).max(0.0) * (1.0 - (y - row as f64).abs()).max(0.0);
                    sum += weight * f64::from(image[plane * pixels + row * width + column]);
                }
            }
            out.push(sum as f32);
        }
    }
    out
}
