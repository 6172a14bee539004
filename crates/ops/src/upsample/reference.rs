//! The definition, in f64.

use super::{NEIGHBOURS, UpsampleShape};

/// One fine pixel of one image.
struct FinePixel {
    image: usize,
    /// Its place in a fine plane.
    place: usize,
    /// The coarse neighbours' places in a coarse plane; those outside have none.
    neighbours: [Option<usize>; NEIGHBOURS],
    /// Where its mask is, for each neighbour.
    mask: [usize; NEIGHBOURS],
}

impl UpsampleShape {
    fn each_fine_pixel(&self, mut visit: impl FnMut(FinePixel)) {
        let Self { batch, coarse: [height, width], factor } = *self;
        for image in 0..batch {
            for (row, column) in (0..height * factor).flat_map(|y| (0..width * factor).map(move |x| (y, x))) {
                let ([y, i], [x, j]) = ([row / factor, row % factor], [column / factor, column % factor]);
                let channel = |k: usize| ((image * NEIGHBOURS + k) * factor + i) * factor + j;
                visit(FinePixel {
                    image,
                    place: row * width * factor + column,
                    neighbours: std::array::from_fn(|k| self.neighbour(y, x, k)),
                    mask: std::array::from_fn(|k| channel(k) * height * width + y * width + x),
                });
            }
        }
    }

    fn fine_pixels(&self) -> usize {
        self.pixels() * self.factor * self.factor
    }
}

fn softmax(scores: [f64; NEIGHBOURS]) -> [f64; NEIGHBOURS] {
    let sum: f64 = scores.iter().map(|score| score.exp()).sum();
    scores.map(|score| score.exp() / sum)
}

/// See [`super::convex_upsample`].
pub fn convex_upsample(flow: &[f64], mask: &[f64], scale: f64, shape: &UpsampleShape) -> Vec<f64> {
    let mut out = vec![0.0; shape.output_len()];
    shape.each_fine_pixel(|fine| {
        let weights = softmax(fine.mask.map(|at| scale * mask[at]));
        for plane in [2 * fine.image, 2 * fine.image + 1] {
            for (weight, neighbour) in weights.iter().zip(fine.neighbours) {
                let value = neighbour.map_or(0.0, |at| flow[plane * shape.pixels() + at]);
                out[plane * shape.fine_pixels() + fine.place] += shape.factor as f64 * weight * value;
            }
        }
    });
    out
}

/// See [`super::convex_upsample_backward`].
pub fn convex_upsample_backward(
    flow: &[f64],
    mask: &[f64],
    scale: f64,
    grad: &[f64],
    shape: &UpsampleShape,
) -> [Vec<f64>; 2] {
    let [mut d_flow, mut d_mask] = [vec![0.0; flow.len()], vec![0.0; mask.len()]];
    shape.each_fine_pixel(|fine| {
        let weights = softmax(fine.mask.map(|at| scale * mask[at]));
        let mut d_weights = [0.0; NEIGHBOURS];
        for plane in [2 * fine.image, 2 * fine.image + 1] {
            let grad = shape.factor as f64 * grad[plane * shape.fine_pixels() + fine.place];
            for (k, neighbour) in fine.neighbours.into_iter().enumerate() {
                if let Some(at) = neighbour {
                    d_weights[k] += flow[plane * shape.pixels() + at] * grad;
                    d_flow[plane * shape.pixels() + at] += weights[k] * grad;
                }
            }
        }
        let mean: f64 = weights.iter().zip(d_weights).map(|(weight, d_weight)| weight * d_weight).sum();
        for (k, at) in fine.mask.into_iter().enumerate() {
            d_mask[at] = scale * weights[k] * (d_weights[k] - mean);
        }
    });
    [d_flow, d_mask]
}
