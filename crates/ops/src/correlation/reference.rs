//! The definition: the all-pairs volume, pooled, sampled bilinearly with zeros outside, in f64.

/// `[batch, levels * (2 radius + 1)^2, height, width]` from feature maps `[batch, channels, height, width]` and positions
/// in the second image `[batch, 2, height, width]` (x, then y, in pixels of the feature map).
///
/// Entry `(i, j)` of a window, `i` the slower, is displaced by `i - radius` in **x** and `j - radius` in **y**: the
/// reference adds `meshgrid(dy, dx)` to `(x, y)` (`core/corr.py` of RAFT), and trained weights expect it.
pub fn correlation_lookup(
    first: &[f32],
    second: &[f32],
    coords: &[f32],
    [batch, channels, height, width]: [usize; 4],
    levels: usize,
    radius: usize,
) -> Vec<f32> {
    let pixels = height * width;
    let side = 2 * radius + 1;
    let mut out = vec![0.0; batch * levels * side * side * pixels];
    for n in 0..batch {
        for p in 0..pixels {
            let feature = |map: &[f32], q: usize, c: usize| f64::from(map[(n * channels + c) * pixels + q]);
            let dot =
                |q: usize| (0..channels).map(|c| feature(first, p, c) * feature(second, q, c)).sum::<f64>();
            let mut plane: Vec<f64> = (0..pixels).map(|q| dot(q) / (channels as f64).sqrt()).collect();
            let (mut level_height, mut level_width) = (height, width);
            for level in 0..levels {
                let scale = f64::from(1_u32 << level);
                let x = f64::from(coords[n * 2 * pixels + p]) / scale;
                let y = f64::from(coords[(n * 2 + 1) * pixels + p]) / scale;
                for i in 0..side {
                    for j in 0..side {
                        let (x, y) = (x + i as f64 - radius as f64, y + j as f64 - radius as f64);
                        let channel = (level * side + i) * side + j;
                        out[(n * levels * side * side + channel) * pixels + p] =
                            sample(&plane, level_height, level_width, x, y) as f32;
                    }
                }
                (plane, level_height, level_width) = pool(&plane, level_height, level_width);
            }
        }
    }
    out
}

fn sample(plane: &[f64], height: usize, width: usize, x: f64, y: f64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    let mut sum = 0.0;
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (column, row) = (x0 + dx, y0 + dy);
        if column >= 0.0 && row >= 0.0 && column < width as f64 && row < height as f64 {
            let weight = (1.0 - (x - column).abs()) * (1.0 - (y - row).abs());
            sum += weight * plane[row as usize * width + column as usize];
        }
    }
    sum
}

fn pool(plane: &[f64], height: usize, width: usize) -> (Vec<f64>, usize, usize) {
    let (half_height, half_width) = (height / 2, width / 2);
    let mut out = Vec::with_capacity(half_height * half_width);
    for y in 0..half_height {
        for x in 0..half_width {
            let at = 2 * y * width + 2 * x;
            out.push((plane[at] + plane[at + 1] + plane[at + width] + plane[at + width + 1]) / 4.0);
        }
    }
    (out, half_height, half_width)
}
