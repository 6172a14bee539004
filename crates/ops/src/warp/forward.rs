use rayon::prelude::*;
use srflow_simd::SharedMut;

use super::Corners;
use crate::MapShape;

/// `image`, of `shape`, sampled at each pixel displaced by `flow` (`[batch, 2, height, width]`, in pixels, u then v). Panics when a slice does not fit `shape`.
pub fn warp(image: &[f32], flow: &[f32], shape: &MapShape) -> Vec<f32> {
    assert_eq!(image.len(), shape.elements(), "image of {shape:?}");
    assert_eq!(flow.len(), shape.with_channels(2).elements(), "flow of {shape:?}");
    let MapShape { batch, channels, height, width } = *shape;
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
