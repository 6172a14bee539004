//! Resizing by linear interpolation along rows and columns. [`mod@reference`] is the definition.

use rayon::prelude::*;
use srflow_simd::zeros;

use crate::MapShape;

mod composed;
pub mod reference;
pub mod tensor;

/// Alignment of the pixel grids of two sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grids {
    /// The centres of the corner pixels (`align_corners=True` of PyTorch).
    CornersOnCorners,
    /// The edges of the image (`align_corners=False`).
    EdgesOnEdges,
    /// The centres of the first pixels, with distances scaled by the ratio of the sizes (`resize_images` of TensorFlow 1).
    FirstOnFirst,
}

impl Grids {
    /// Position of pixel `i` of `size` in a grid of `from` pixels, within that grid.
    fn place(self, i: usize, from: usize, size: usize) -> f64 {
        match self {
            Self::CornersOnCorners => (i * (from - 1)) as f64 / (size - 1).max(1) as f64,
            Self::FirstOnFirst => (i * from) as f64 / size as f64,
            Self::EdgesOnEdges => {
                let place = (i as f64 + 0.5) * from as f64 / size as f64 - 0.5;
                place.clamp(0.0, (from - 1) as f64)
            }
        }
    }
}

/// The two pixels of `from` that each pixel along an axis lies between, and how far from the first.
struct Places {
    pixels: Vec<[usize; 2]>,
    fractions: Vec<f32>,
}

impl Places {
    fn new(from: usize, size: usize, grids: Grids) -> Self {
        let place = |i| {
            let place = grids.place(i, from, size);
            let first = place.floor() as usize;
            ([first, (first + 1).min(from - 1)], (place - place.floor()) as f32)
        };
        let (pixels, fractions) = (0..size).map(place).unzip();
        Self { pixels, fractions }
    }

    fn iter(&self) -> impl Iterator<Item = ([usize; 2], f32)> {
        self.pixels.iter().copied().zip(self.fractions.iter().copied())
    }
}

/// `input`, maps of `shape`, resized to height and width `size`. Panics when the length of the slice does not match the shape.
pub fn resize(input: &[f32], shape: MapShape, size: [usize; 2], grids: Grids) -> Vec<f32> {
    assert_eq!(input.len(), shape.elements(), "input of {shape:?}");
    let mut out = zeros(shape.planes() * size[0] * size[1]);
    if out.is_empty() {
        return out;
    }
    let rows = Places::new(shape.height, size[0], grids);
    let columns = Places::new(shape.width, size[1], grids);
    let planes = out.par_chunks_mut(size[0] * size[1]).zip(input.par_chunks(shape.pixels()));
    planes.for_each_init(
        || vec![0.0; shape.width],
        |row, (out, plane)| {
            for (out, ([upper, lower], fraction)) in out.chunks_exact_mut(size[1]).zip(rows.iter()) {
                let [upper, lower] = [upper, lower].map(|y| &plane[y * shape.width..][..shape.width]);
                for ((to, upper), lower) in row.iter_mut().zip(upper).zip(lower) {
                    *to = upper + (lower - upper) * fraction;
                }
                for (out, ([left, right], fraction)) in out.iter_mut().zip(columns.iter()) {
                    *out = row[left] + (row[right] - row[left]) * fraction;
                }
            }
        },
    );
    out
}

/// Gradient of the input, given `grad`, that of the output. Panics when the length of the slice does not match the sizes.
pub fn resize_backward(grad: &[f32], shape: MapShape, size: [usize; 2], grids: Grids) -> Vec<f32> {
    assert_eq!(grad.len(), shape.planes() * size[0] * size[1], "gradient of {shape:?} resized to {size:?}");
    let mut out = vec![0.0; shape.elements()];
    if grad.is_empty() {
        return out;
    }
    let rows = Places::new(shape.height, size[0], grids);
    let columns = Places::new(shape.width, size[1], grids);
    let planes = out.par_chunks_mut(shape.pixels()).zip(grad.par_chunks(size[0] * size[1]));
    planes.for_each_init(
        || vec![0.0; shape.width],
        |row, (out, grad)| {
            for (grad, ([upper, lower], fraction)) in grad.chunks_exact(size[1]).zip(rows.iter()) {
                row.fill(0.0);
                for (grad, ([left, right], fraction)) in grad.iter().zip(columns.iter()) {
                    row[left] += grad * (1.0 - fraction);
                    row[right] += grad * fraction;
                }
                for (y, weight) in [(upper, 1.0 - fraction), (lower, fraction)] {
                    let out = &mut out[y * shape.width..][..shape.width];
                    out.iter_mut().zip(&*row).for_each(|(out, grad)| *out += grad * weight);
                }
            }
        },
    );
    out
}

#[cfg(test)]
pub(crate) mod tests;
