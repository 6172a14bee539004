//! The definition, in f64: the all-pairs volume, pooled, sampled bilinearly with zeros outside.

use crate::warp::reference::tent;

/// A lookup of this size.
#[derive(Debug, Clone, Copy)]
pub struct LookupShape {
    /// Of each feature map: `[batch, channels, height, width]`.
    pub maps: [usize; 4],
    /// Levels of the pyramid.
    pub levels: usize,
    /// Of a window, in pixels of its level.
    pub radius: usize,
}

impl LookupShape {
    /// Elements of the output.
    pub fn output_len(&self) -> usize {
        let [batch, _, height, width] = self.maps;
        batch * self.levels * self.side() * self.side() * height * width
    }

    /// Entries of a row of a window.
    fn side(&self) -> usize {
        2 * self.radius + 1
    }

    /// Height and width of a level.
    fn level(&self, level: usize) -> [usize; 2] {
        let [_, _, height, width] = self.maps;
        [height >> level, width >> level]
    }

    /// The pairs `(n, p)` of an image and a pixel of its first map.
    fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let [batch, _, height, width] = self.maps;
        (0..batch).flat_map(move |n| (0..height * width).map(move |p| (n, p)))
    }

    /// Where channel `c` of pixel `p` of image `n` is in a feature map.
    fn feature(&self, n: usize, c: usize, p: usize) -> usize {
        let [_, channels, height, width] = self.maps;
        (n * channels + c) * height * width + p
    }

    /// The dot products of pixel `p` with every pixel of the second map, over the root of the channels.
    fn products(&self, first: &[f64], second: &[f64], n: usize, p: usize) -> Vec<f64> {
        let [_, channels, height, width] = self.maps;
        let product = |q, c| first[self.feature(n, c, p)] * second[self.feature(n, c, q)];
        let sum = |q| (0..channels).map(|c| product(q, c)).sum::<f64>();
        (0..height * width).map(|q| sum(q) / (channels as f64).sqrt()).collect()
    }

    /// Calls `visit(output, pixel, weight)` for each entry of the window of pixel `p` at a level and each pixel of that level.
    fn each_sample(
        &self,
        coords: &[f64],
        [n, p]: [usize; 2],
        level: usize,
        mut visit: impl FnMut(usize, usize, f64),
    ) {
        let ([_, _, height, width], [level_height, level_width]) = (self.maps, self.level(level));
        let (pixels, entries) = (height * width, self.side() * self.side());
        let [x, y] = [2 * n, 2 * n + 1].map(|plane| coords[plane * pixels + p] / f64::from(1 << level));
        for entry in 0..entries {
            let (i, j) = (entry / self.side(), entry % self.side());
            let (x, y) = (x + i as f64 - self.radius as f64, y + j as f64 - self.radius as f64);
            let output = ((n * self.levels + level) * entries + entry) * pixels + p;
            for q in 0..level_height * level_width {
                let weight = tent(x - (q % level_width) as f64) * tent(y - (q / level_width) as f64);
                visit(output, q, weight);
            }
        }
    }
}

/// Calls `visit(coarse, fine)` for each pixel of a level and each of the four that it is the mean of; a last odd row or
/// column is no part of any.
fn each_pooled([height, width]: [usize; 2], mut visit: impl FnMut(usize, usize)) {
    for (y, x) in (0..height / 2 * 2).flat_map(|y| (0..width / 2 * 2).map(move |x| (y, x))) {
        visit(y / 2 * (width / 2) + x / 2, y * width + x);
    }
}

/// `[batch, levels * (2 radius + 1)^2, height, width]` from feature maps `[batch, channels, height, width]` and positions
/// in the second image `[batch, 2, height, width]` (x, then y, in pixels of the feature map).
///
/// Entry `(i, j)` of a window, `i` the slower, is displaced by `i - radius` in **x** and `j - radius` in **y**: the
/// reference adds `meshgrid(dy, dx)` to `(x, y)` (`core/corr.py` of RAFT), and trained weights expect it.
pub fn correlation_lookup(first: &[f64], second: &[f64], coords: &[f64], shape: &LookupShape) -> Vec<f64> {
    let mut out = vec![0.0; shape.output_len()];
    for (n, p) in shape.pixels() {
        let mut plane = shape.products(first, second, n, p);
        for level in 0..shape.levels {
            shape.each_sample(coords, [n, p], level, |output, q, weight| out[output] += weight * plane[q]);
            let mut pooled = vec![0.0; shape.level(level + 1).iter().product()];
            each_pooled(shape.level(level), |coarse, fine| pooled[coarse] += plane[fine] / 4.0);
            plane = pooled;
        }
    }
    out
}

/// Gradients of both feature maps from `grad`, that of the output of [`correlation_lookup`].
pub fn correlation_lookup_backward(
    first: &[f64],
    second: &[f64],
    coords: &[f64],
    grad: &[f64],
    shape: &LookupShape,
) -> [Vec<f64>; 2] {
    let [_, channels, height, width] = shape.maps;
    let [mut d_first, mut d_second] = [vec![0.0; first.len()], vec![0.0; second.len()]];
    for (n, p) in shape.pixels() {
        let mut d_plane = Vec::new();
        for level in (0..shape.levels).rev() {
            let mut d_fine = vec![0.0; shape.level(level).iter().product()];
            if level + 1 < shape.levels {
                each_pooled(shape.level(level), |coarse, fine| d_fine[fine] += d_plane[coarse] / 4.0);
            }
            shape.each_sample(coords, [n, p], level, |output, q, weight| d_fine[q] += weight * grad[output]);
            d_plane = d_fine;
        }
        for (q, c) in (0..height * width).flat_map(|q| (0..channels).map(move |c| (q, c))) {
            let d_product = d_plane[q] / (channels as f64).sqrt();
            d_first[shape.feature(n, c, p)] += d_product * second[shape.feature(n, c, q)];
            d_second[shape.feature(n, c, q)] += d_product * first[shape.feature(n, c, p)];
        }
    }
    [d_first, d_second]
}
