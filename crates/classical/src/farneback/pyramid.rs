//! The pyramid: every level is computed from the full-size frame, blurred for that level and then resized.

use rayon::prelude::*;
use srflow_core::resize::resize_linear;
use srflow_core::{Plane, Size};

use srflow_simd::multiversioned;

/// `frame` blurred for `scale` (level pixels per frame pixel) and resized to `size`.
pub fn level(frame: &Plane, size: Size, scale: f64) -> Plane {
    let blurred = blur(frame, &blur_kernel(scale));
    if frame.size() == size { blurred } else { resize_linear(&blurred, size, 1.0) }
}

/// The Gaussian of OpenCV's `getGaussianKernel` with the size and deviation of a level; of odd length.
pub fn blur_kernel(scale: f64) -> Vec<f32> {
    let sigma = (1.0 / scale - 1.0) * 0.5;
    if sigma <= 0.0 {
        return vec![0.25, 0.5, 0.25]; // OpenCV's kernel of size 3 when no deviation is given
    }
    let size = ((sigma * 5.0).round_ties_even() as usize | 1).max(3);
    let weight = |i: usize| {
        let x = i as f64 * 2.0 - (size - 1) as f64;
        libm::exp(x * x * (-0.125 / (sigma * sigma)))
    };
    let sum = 1.0 + 2.0 * (0..size / 2).map(weight).sum::<f64>();
    (0..size).map(|i| (weight(i) * (1.0 / sum)) as f32).collect()
}

/// Rows of kernels up to this length are summed from the outside in.
const SHORT_KERNEL: usize = 5;

/// Rows that one task blurs.
const ROWS_PER_TASK: usize = 32;

/// Separable convolution with a symmetric kernel; outside, the frame is mirrored without repeating the border
/// (`BORDER_REFLECT_101`).
///
/// Farneback's iterations magnify the last bit of their input, so matching OpenCV's results requires its rounding: products
/// are fused into sums in the order of its filters, except in the remainder columns of its vectors of 8.
pub fn blur(frame: &Plane, kernel: &[f32]) -> Plane {
    let Size { width, height } = frame.size();
    let radius = kernel.len() / 2;
    let fused = if kernel.len() <= SHORT_KERNEL { width } else { width - width % 8 };
    let mut across = Plane::new(width, height);
    let band = (width * ROWS_PER_TASK).max(1);
    across.pixels_mut().par_chunks_mut(band).zip(frame.pixels().par_chunks(band)).for_each(|(out, rows)| {
        let mut padded = vec![0.0; width + 2 * radius];
        for (out, row) in out.chunks_exact_mut(width).zip(rows.chunks_exact(width)) {
            padded[radius..radius + width].copy_from_slice(row);
            for i in 1..=radius {
                padded[radius - i] = row[mirror(-(i as isize), width)];
                padded[radius + width - 1 + i] = row[mirror((width - 1 + i) as isize, width)];
            }
            if kernel.len() <= SHORT_KERNEL {
                blur_row_short(out, &padded, kernel);
            } else {
                blur_row(&mut out[..fused], &padded, kernel);
                blur_row_unfused(&mut out[fused..], &padded[fused..], kernel);
            }
        }
    });
    let mut blurred = Plane::new(width, height);
    blurred.pixels_mut().par_chunks_mut(width.max(1)).enumerate().for_each(|(y, out)| {
        let row = |offset: isize| across.row(mirror(y as isize + offset, height));
        start_column(out, row(0), kernel[radius]);
        for (i, weight) in (1..).zip(&kernel[radius + 1..]) {
            let (above, below) = (row(-i), row(i));
            add_to_column(&mut out[..fused], above, below, *weight);
            add_to_column_unfused(&mut out[fused..], &above[fused..], &below[fused..], *weight);
        }
    });
    blurred
}

/// The index inside `0..len` for position `i` when the signal is mirrored at the centres of its end pixels.
pub fn mirror(i: isize, len: usize) -> usize {
    let period = (2 * len as isize - 2).max(1);
    let i = i.rem_euclid(period);
    if i < len as isize { i as usize } else { (period - i) as usize }
}

/// Pixels whose sums are held in registers together.
const BLOCK: usize = 64;

multiversioned! {
    fn blur_row(out: &mut [f32], padded: &[f32], kernel: &[f32]) {
        let mut blocks = out.chunks_exact_mut(BLOCK);
        let mut start = 0;
        for out in &mut blocks {
            let mut sums = [0.0_f32; BLOCK];
            for (i, weight) in kernel.iter().enumerate() {
                let values = &padded[start + i..start + i + BLOCK];
                for (sum, value) in sums.iter_mut().zip(values) {
                    *sum = value.mul_add(*weight, *sum);
                }
            }
            out.copy_from_slice(&sums);
            start += BLOCK;
        }
        for (x, out) in (start..).zip(blocks.into_remainder()) {
            *out = kernel.iter().zip(&padded[x..]).fold(0.0, |sum, (weight, value)| value.mul_add(*weight, sum));
        }
    }
}

fn blur_row_unfused(out: &mut [f32], padded: &[f32], kernel: &[f32]) {
    for (x, out) in out.iter_mut().enumerate() {
        *out = kernel.iter().zip(&padded[x..]).map(|(weight, value)| value * weight).sum();
    }
}

multiversioned! {
    /// [`blur_row`] as OpenCV does it for short kernels: from the outside in.
    fn blur_row_short(out: &mut [f32], padded: &[f32], kernel: &[f32]) {
        let (len, last) = (out.len(), kernel.len() - 1);
        for x in 0..len {
            let mut sum = (padded[x] + padded[x + last]) * kernel[0];
            for (i, weight) in kernel.iter().enumerate().take(kernel.len() / 2).skip(1) {
                sum = (padded[x + i] + padded[x + last - i]).mul_add(*weight, sum);
            }
            out[x] = padded[x + kernel.len() / 2].mul_add(kernel[kernel.len() / 2], sum);
        }
    }
}

multiversioned! {
    fn start_column(out: &mut [f32], centre: &[f32], weight: f32) {
        for (out, centre) in out.iter_mut().zip(centre) {
            *out = centre * weight;
        }
    }
}

fn add_to_column_unfused(out: &mut [f32], above: &[f32], below: &[f32], weight: f32) {
    for ((out, above), below) in out.iter_mut().zip(above).zip(below) {
        *out += (above + below) * weight;
    }
}

multiversioned! {
    fn add_to_column(out: &mut [f32], above: &[f32], below: &[f32], weight: f32) {
        for ((out, above), below) in out.iter_mut().zip(above).zip(below) {
            *out = (above + below).mul_add(weight, *out);
        }
    }
}
