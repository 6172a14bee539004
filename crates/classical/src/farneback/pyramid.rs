//! The pyramid: every level is made from the full-size frame, blurred for that level and then resized.

use srflow_field::Plane;

use crate::resize::resize_linear;

/// `frame` blurred for `scale` (level pixels per frame pixel) and resized to `width` x `height`.
pub fn level(frame: &Plane, width: usize, height: usize, scale: f64) -> Plane {
    let kernel = blur_kernel(scale);
    let blurred = blur(frame, &kernel);
    if frame.size() == (width, height) {
        return blurred;
    }
    resize_linear(&blurred, width, height, 1.0)
}

/// The Gaussian of OpenCV's `getGaussianKernel` with the size and deviation that the level asks for; odd length.
fn blur_kernel(scale: f64) -> Vec<f32> {
    let sigma = (1.0 / scale - 1.0) * 0.5;
    let size = ((sigma * 5.0).round_ties_even() as usize | 1).max(3);
    if sigma <= 0.0 {
        return vec![0.25, 0.5, 0.25]; // the binomial kernel OpenCV has for size 3 without a deviation
    }
    let centre = (size / 2) as f64;
    let weights: Vec<f64> =
        (0..size).map(|i| libm::exp(-0.5 * ((i as f64 - centre) / sigma).powi(2))).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|weight| (weight / sum) as f32).collect()
}

/// Separable convolution; outside the frame it is mirrored without repeating the border (`BORDER_REFLECT_101`).
fn blur(frame: &Plane, kernel: &[f32]) -> Plane {
    let (width, height) = frame.size();
    let radius = (kernel.len() / 2) as isize;
    let across = Plane::from_fn(width, height, |x, y| {
        let row = frame.row(y);
        kernel.iter().zip(-radius..).map(|(k, i)| k * row[reflect(x as isize + i, width)]).sum()
    });
    Plane::from_fn(width, height, |x, y| {
        kernel.iter().zip(-radius..).map(|(k, i)| k * across.get(x, reflect(y as isize + i, height))).sum()
    })
}

/// The index inside `0..len` that position `i` shows when the signal is mirrored at the centres of its end pixels.
fn reflect(i: isize, len: usize) -> usize {
    let period = (2 * len as isize - 2).max(1);
    let i = i.rem_euclid(period);
    if i < len as isize { i as usize } else { (period - i) as usize }
}
