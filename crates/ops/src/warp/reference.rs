//! The definition, in f64: a sample is a sum over all pixels of the image, each with the weight that its distance gives it.

use crate::MapShape;

/// The weight of a pixel for a sample that lies `distance` pixels beyond it, along one axis.
pub(crate) fn tent(distance: f64) -> f64 {
    (1.0 - distance.abs()).max(0.0)
}

/// Derivative of [`tent`]; from the right where it has a corner, as in PyTorch.
fn tent_slope(distance: f64) -> f64 {
    match distance {
        -1.0..0.0 => 1.0,
        0.0..1.0 => -1.0,
        _ => 0.0,
    }
}

/// Calls `visit(sample, pixel, [n, p], [dx, dy])` for each sample and each pixel of the same plane: their places in output
/// and image, the image and the pixel that the flow displaces, and how far the sample lies beyond the pixel.
fn each_pair(flow: &[f64], shape: &MapShape, mut visit: impl FnMut(usize, usize, [usize; 2], [f64; 2])) {
    let MapShape { batch, channels, height, width } = *shape;
    let pixels = height * width;
    for plane in 0..batch * channels {
        let n = plane / channels;
        for p in 0..pixels {
            let x = (p % width) as f64 + flow[n * 2 * pixels + p];
            let y = (p / width) as f64 + flow[(n * 2 + 1) * pixels + p];
            for q in 0..pixels {
                let distance = [x - (q % width) as f64, y - (q / width) as f64];
                visit(plane * pixels + p, plane * pixels + q, [n, p], distance);
            }
        }
    }
}

/// See [`super::warp`].
pub fn warp(image: &[f64], flow: &[f64], shape: &MapShape) -> Vec<f64> {
    let mut out = vec![0.0; image.len()];
    each_pair(flow, shape, |sample, pixel, _, [dx, dy]| out[sample] += tent(dx) * tent(dy) * image[pixel]);
    out
}

/// See [`super::warp_backward`].
pub fn warp_backward(image: &[f64], flow: &[f64], grad: &[f64], shape: &MapShape) -> [Vec<f64>; 2] {
    let [mut d_image, mut d_flow] = [vec![0.0; image.len()], vec![0.0; flow.len()]];
    let pixels = shape.pixels();
    each_pair(flow, shape, |sample, pixel, [n, p], [dx, dy]| {
        d_image[pixel] += tent(dx) * tent(dy) * grad[sample];
        d_flow[n * 2 * pixels + p] += tent_slope(dx) * tent(dy) * image[pixel] * grad[sample];
        d_flow[(n * 2 + 1) * pixels + p] += tent(dx) * tent_slope(dy) * image[pixel] * grad[sample];
    });
    [d_image, d_flow]
}
