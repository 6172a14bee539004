//! The definition, in f64.

use super::{COMPONENTS, LogScaleRange, PARTS};

/// A mixture at a pixel.
struct Mixture {
    weights: [f64; PARTS],
    scales: [f64; PARTS],
    /// Derivative of the logarithm of a scale by its input: 0 outside of its range.
    free: [f64; PARTS],
}

impl Mixture {
    fn at(at: [usize; PARTS], log_weights: &[f64], log_scales: &[f64], range: LogScaleRange) -> Self {
        let sum: f64 = at.iter().map(|&at| log_weights[at].exp()).sum();
        let limits = [(0.0, f64::from(range.high)), (f64::from(range.low), 0.0)];
        let inside = |k: usize| log_scales[at[k]] >= limits[k].0 && log_scales[at[k]] <= limits[k].1;
        Self {
            weights: at.map(|at| log_weights[at].exp() / sum),
            scales: std::array::from_fn(|k| log_scales[at[k]].clamp(limits[k].0, limits[k].1).exp()),
            free: std::array::from_fn(|k| f64::from(u8::from(inside(k)))),
        }
    }

    /// The weighted densities at a difference.
    fn densities(&self, difference: f64) -> [f64; PARTS] {
        std::array::from_fn(|k| {
            self.weights[k] / (2.0 * self.scales[k]) * (-difference.abs() / self.scales[k]).exp()
        })
    }
}

/// The indices of both channels of every pixel of every image.
fn pixels_of(count: usize, pixels: usize) -> impl Iterator<Item = [usize; 2]> {
    let images = count / (2 * pixels);
    (0..images).flat_map(move |n| (0..pixels).map(move |p| [2 * n * pixels + p, (2 * n + 1) * pixels + p]))
}

/// See [`super::negative_log_likelihood`].
pub fn negative_log_likelihood(
    [difference, log_weights, log_scales]: [&[f64]; 3],
    pixels: usize,
    range: LogScaleRange,
) -> Vec<f64> {
    let mut out = vec![0.0; difference.len()];
    for at in pixels_of(difference.len(), pixels) {
        let mixture = Mixture::at(at, log_weights, log_scales, range);
        for at in at {
            out[at] = -mixture.densities(difference[at]).iter().sum::<f64>().ln();
        }
    }
    out
}

/// See [`super::negative_log_likelihood_backward`].
pub fn negative_log_likelihood_backward(
    [difference, log_weights, log_scales]: [&[f64]; 3],
    grad: &[f64],
    pixels: usize,
    range: LogScaleRange,
) -> [Vec<f64>; 3] {
    let mut found = [(); 3].map(|()| vec![0.0; difference.len()]);
    for at in pixels_of(difference.len(), pixels) {
        let mixture = Mixture::at(at, log_weights, log_scales, range);
        for component in 0..COMPONENTS {
            let (d, grad) = (difference[at[component]], grad[at[component]]);
            let densities = mixture.densities(d);
            let sum: f64 = densities.iter().sum();
            for k in 0..PARTS {
                let (likely, scale) = (densities[k] / sum, mixture.scales[k]);
                found[0][at[component]] += grad * likely / scale * if d == 0.0 { 0.0 } else { d.signum() };
                found[1][at[k]] += grad * (mixture.weights[k] - likely);
                found[2][at[k]] += grad * likely * (1.0 - d.abs() / scale) * mixture.free[k];
            }
        }
    }
    found
}
