use rayon::prelude::*;
use srflow_simd::SharedMut;

use super::forward::{Neighbours, weights};
use super::{NEIGHBOURS, UpsampleShape};

/// Gradients of the flow and of the mask, given `grad`, that of the output. Panics when the length of a slice does not match
/// `shape`.
pub fn convex_upsample_backward(
    flow: &[f32],
    mask: &[f32],
    scale: f32,
    grad: &[f32],
    shape: &UpsampleShape,
) -> [Vec<f32>; 2] {
    assert_eq!(flow.len(), shape.flow_len(), "flow of {shape:?}");
    assert_eq!(mask.len(), shape.mask_len(), "mask of {shape:?}");
    assert_eq!(grad.len(), shape.output_len(), "gradient of {shape:?}");
    let UpsampleShape { batch, coarse: [height, width], factor } = *shape;
    let pixels = height * width;
    let mut d_mask = vec![0.0; mask.len()];
    // The contributions of each coarse pixel to its neighbours: [batch * height, width, neighbour, u and v].
    let mut given = vec![[[0.0_f32; 2]; NEIGHBOURS]; batch * pixels];
    let target = SharedMut::new(&mut d_mask);
    given.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, given)| {
        let (n, y) = (row / height, row % height);
        let neighbours = Neighbours::new(flow, shape, n, y);
        for (i, j) in (0..factor).flat_map(|i| (0..factor).map(move |j| (i, j))) {
            for (x, given) in given.iter_mut().enumerate() {
                let weights = weights(mask, scale, shape, [n, i, j], y * width + x);
                let fine = |c: usize| {
                    let row = ((n * 2 + c) * height + y) * factor + i;
                    grad[row * width * factor + x * factor + j] * factor as f32
                };
                let grad = [fine(0), fine(1)];
                let along: [f32; NEIGHBOURS] = std::array::from_fn(|k| {
                    let [u, v] = neighbours.at(x, k);
                    grad[0] * u + grad[1] * v
                });
                let mean: f32 = weights.iter().zip(along).map(|(weight, along)| weight * along).sum();
                for k in 0..NEIGHBOURS {
                    let channel = ((n * NEIGHBOURS + k) * factor + i) * factor + j;
                    // SAFETY: this row of this image belongs to this task.
                    unsafe {
                        *target.at(channel * pixels + y * width + x) = scale * weights[k] * (along[k] - mean)
                    }
                    given[k][0] += weights[k] * grad[0];
                    given[k][1] += weights[k] * grad[1];
                }
            }
        }
    });
    let mut d_flow = vec![0.0; flow.len()];
    for (pixel, given) in given.iter().enumerate() {
        let (n, pixel) = (pixel / pixels, pixel % pixels);
        for (k, given) in given.iter().enumerate() {
            if let Some(to) = shape.neighbour(pixel / width, pixel % width, k) {
                d_flow[n * 2 * pixels + to] += given[0];
                d_flow[(n * 2 + 1) * pixels + to] += given[1];
            }
        }
    }
    [d_flow, d_mask]
}
