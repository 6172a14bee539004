use rayon::prelude::*;

use super::{NEIGHBOURS, UpsampleShape};

/// Flow in pixels of the fine grid: `factor` times the combination of the 3x3 coarse neighbours (zero outside) with the weights
/// `softmax(scale * mask)`. Panics when the length of a slice does not match `shape`.
pub fn convex_upsample(flow: &[f32], mask: &[f32], scale: f32, shape: &UpsampleShape) -> Vec<f32> {
    assert_eq!(flow.len(), shape.flow_len(), "flow of {shape:?}");
    assert_eq!(mask.len(), shape.mask_len(), "mask of {shape:?}");
    let UpsampleShape { coarse: [height, width], factor, .. } = *shape;
    let mut out = vec![0.0; shape.output_len()];
    if out.is_empty() {
        return out;
    }
    let (fine_row, plane) = (width * factor, height * width * factor * factor);
    for (n, out) in out.chunks_exact_mut(2 * plane).enumerate() {
        let (u, v) = out.split_at_mut(plane);
        let rows = u.par_chunks_mut(fine_row).zip(v.par_chunks_mut(fine_row));
        rows.enumerate().for_each(|(row, out)| {
            let (y, i) = (row / factor, row % factor);
            let neighbours = Neighbours::new(flow, shape, n, y);
            for j in 0..factor {
                for x in 0..width {
                    let weights = weights(mask, scale, shape, [n, i, j], y * width + x);
                    let mut sums = [0.0; 2];
                    for (k, weight) in weights.iter().enumerate() {
                        let [u, v] = neighbours.at(x, k);
                        sums[0] += weight * u;
                        sums[1] += weight * v;
                    }
                    out.0[x * factor + j] = sums[0] * factor as f32;
                    out.1[x * factor + j] = sums[1] * factor as f32;
                }
            }
        });
    }
    out
}

/// The weights of fine pixel `(i, j)` of a coarse pixel of image `n`.
pub(super) fn weights(
    mask: &[f32],
    scale: f32,
    shape: &UpsampleShape,
    [n, i, j]: [usize; 3],
    pixel: usize,
) -> [f32; NEIGHBOURS] {
    let per_neighbour = shape.factor * shape.factor;
    let mut weights: [f32; NEIGHBOURS] = std::array::from_fn(|k| {
        let channel = (n * NEIGHBOURS + k) * per_neighbour + i * shape.factor + j;
        scale * mask[channel * shape.pixels() + pixel]
    });
    let largest = weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut total = 0.0;
    for weight in &mut weights {
        *weight = (*weight - largest).exp();
        total += *weight;
    }
    weights.map(|weight| weight / total)
}

/// The three rows of coarse flow around row `y`, zero-padded.
pub(super) struct Neighbours {
    width: usize,
    rows: Vec<[f32; 2]>,
}

impl Neighbours {
    pub(super) fn new(flow: &[f32], shape: &UpsampleShape, n: usize, y: usize) -> Self {
        let [height, width] = shape.coarse;
        let pixels = shape.pixels();
        let mut rows = vec![[0.0; 2]; 3 * (width + 2)];
        for (k, row) in rows.chunks_exact_mut(width + 2).enumerate() {
            let Some(y) = (y + k).checked_sub(1).filter(|&y| y < height) else { continue };
            for (x, to) in row[1..=width].iter_mut().enumerate() {
                let at = n * 2 * pixels + y * width + x;
                *to = [flow[at], flow[at + pixels]];
            }
        }
        Self { width, rows }
    }

    /// Neighbour `k` of column `x`.
    pub(super) fn at(&self, x: usize, k: usize) -> [f32; 2] {
        self.rows[k / 3 * (self.width + 2) + x + k % 3]
    }
}
