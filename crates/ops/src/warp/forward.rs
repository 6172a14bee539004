use rayon::prelude::*;
use srflow_simd::SharedMut;

use super::{Corners, WarpShape};

/// `image` sampled at each pixel displaced by `flow`. Panics when a slice does not fit `shape`.
pub fn warp(image: &[f32], flow: &[f32], shape: &WarpShape) -> Vec<f32> {
    assert_eq!(image.len(), shape.image_len(), "image of {shape:?}");
    assert_eq!(flow.len(), shape.flow_len(), "flow of {shape:?}");
    let WarpShape { batch, channels, size: [height, width] } = *shape;
    let pixels = shape.pixels();
    let mut out = vec![0.0; image.len()];
    let target = SharedMut::new(&mut out);
    (0..batch * height).into_par_iter().for_each(|row| {
        let (n, y) = (row / height, row % height);
        for x in 0..width {
            let at = y * width + x;
            let uv = [flow[n * 2 * pixels + at], flow[(n * 2 + 1) * pixels + at]];
            let corners = Corners::new([height, width], [x, y], uv);
            let weights = corners.weights();
            for c in 0..channels {
                let plane = &image[(n * channels + c) * pixels..][..pixels];
                let sum: f32 = corners.values(plane).iter().zip(weights).map(|(v, w)| v * w).sum();
                // SAFETY: this row of this image belongs to this task.
                unsafe { *target.at((n * channels + c) * pixels + at) = sum }
            }
        }
    });
    out
}
