use rayon::prelude::*;

use super::Corners;
use crate::MapShape;

/// Gradients of the image and of the flow, given `grad`, that of the output. Each channel is summed in the order of the pixels, so
/// the result does not depend on the number of threads. Panics when the length of a slice does not match `shape`.
pub fn warp_backward(image: &[f32], flow: &[f32], grad: &[f32], shape: &MapShape) -> [Vec<f32>; 2] {
    assert_eq!(image.len(), shape.elements(), "image of {shape:?}");
    assert_eq!(flow.len(), shape.with_channels(2).elements(), "flow of {shape:?}");
    assert_eq!(grad.len(), shape.elements(), "gradient of {shape:?}");
    let MapShape { channels, height, width, .. } = *shape;
    let pixels = shape.pixels();
    let corners = |n: usize, at: usize| {
        let uv = [flow[n * 2 * pixels + at], flow[(n * 2 + 1) * pixels + at]];
        Corners::new([height, width], [at % width, at / width], uv)
    };
    let mut d_image = vec![0.0; image.len()];
    d_image.par_chunks_mut(pixels.max(1)).enumerate().for_each(|(plane, to)| {
        for (at, grad) in grad[plane * pixels..][..pixels].iter().enumerate() {
            let corners = corners(plane / channels, at);
            for (pixel, weight) in corners.pixels.iter().zip(corners.weights()) {
                if let Some(pixel) = pixel {
                    to[*pixel] += weight * grad;
                }
            }
        }
    });
    let mut d_flow = vec![0.0; flow.len()];
    for (n, d_flow) in d_flow.chunks_exact_mut((2 * pixels).max(1)).enumerate() {
        let (du, dv) = d_flow.split_at_mut(pixels);
        du.par_iter_mut().zip(dv).enumerate().for_each(|(at, (du, dv))| {
            let corners = corners(n, at);
            let [x, y] = corners.fraction;
            for c in 0..channels {
                let plane = (n * channels + c) * pixels;
                let [a, b, c, d] = corners.values(&image[plane..][..pixels]);
                let grad = grad[plane + at];
                *du += grad * ((b - a) * (1.0 - y) + (d - c) * y);
                *dv += grad * ((c - a) * (1.0 - x) + (d - b) * x);
            }
        });
    }
    [d_image, d_flow]
}
