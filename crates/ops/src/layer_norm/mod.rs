//! Layer normalization (Ba et al. 2016) over the channels of each pixel without learned scale, with the activation that follows.
//! [`mod@reference`] is the definition.

use rayon::prelude::*;
use srflow_simd::{Isa, activate, copy_pieces, multiversioned};

use crate::{Activation, MapShape};

mod composed;
pub mod reference;
pub mod tensor;

/// Pixels whose channels are summed up together, so that they are read from memory once.
const BLOCK: usize = 128;

/// `activation((x - mean) / sqrt(variance + epsilon))` of the channels of each pixel. Panics when the input does not
/// fit `shape`, or there are no channels or pixels.
pub fn layer_norm(input: &[f32], shape: &MapShape, epsilon: f64, activation: Activation) -> Vec<f32> {
    let (channels, pixels) = (shape.channels, shape.pixels());
    let isa = Isa::best();
    let moments = of_pixels(shape, [input], |image, own, [mean, scale, _, _]| {
        standardize(image[0], pixels, epsilon, own, mean, scale);
    });
    copy_pieces(input, pixels, |plane, out| {
        let [mean, scale, _, _] = moments.of_image(plane / channels);
        normalize(out, mean, scale);
        if activation != Activation::Identity {
            activate(isa, activation, None, out);
        }
    })
}

/// Gradient of the input of a normalization without activation, from `grad`, that of its output. Panics as [`layer_norm`].
pub fn layer_norm_backward(input: &[f32], grad: &[f32], shape: &MapShape, epsilon: f64) -> Vec<f32> {
    let (channels, pixels) = (shape.channels, shape.pixels());
    let moments = of_pixels(shape, [input, grad], |[input, grad], own, [mean, scale, shift, stretch]| {
        standardize(input, pixels, epsilon, own, mean, scale);
        shift_and_stretch([input, grad], pixels, own, [mean, scale], shift, stretch);
    });
    copy_pieces(input, pixels, |plane, out| {
        let grad = &grad[plane * pixels..][..pixels];
        normalize_backward(out, grad, moments.of_image(plane / channels));
    })
}

/// Four numbers for each pixel: mean and one over the standard deviation of its channels; the mean of its gradients, and of
/// their products with what was normalized.
struct Moments {
    numbers: Vec<f32>,
    pixels: usize,
}

impl Moments {
    fn of_image(&self, image: usize) -> [&[f32]; 4] {
        let own = &self.numbers[4 * self.pixels * image..][..4 * self.pixels];
        [0, 1, 2, 3].map(|number| &own[number * self.pixels..][..self.pixels])
    }
}

/// Calls `fill` with the planes of an image, the first of the pixels whose moments are to be computed, and those.
fn of_pixels<const N: usize>(
    shape: &MapShape,
    inputs: [&[f32]; N],
    fill: impl Fn([&[f32]; N], usize, [&mut [f32]; 4]) + Sync,
) -> Moments {
    let (pixels, image) = (shape.pixels(), shape.channels * shape.pixels());
    assert!(image > 0, "layer_norm: channels and pixels: {shape:?}");
    for input in inputs {
        assert_eq!(input.len(), shape.elements(), "layer_norm of {shape:?}");
    }
    let mut numbers = vec![0.0; shape.batch * 4 * pixels];
    numbers.par_chunks_mut(4 * pixels).enumerate().for_each(|(number, numbers)| {
        let planes = inputs.map(|input| &input[number * image..][..image]);
        let (first, second) = numbers.split_at_mut(2 * pixels);
        let (mean, scale) = first.split_at_mut(pixels);
        let (shift, stretch) = second.split_at_mut(pixels);
        let blocks = mean.par_chunks_mut(BLOCK).zip(scale.par_chunks_mut(BLOCK));
        let blocks = blocks.zip(shift.par_chunks_mut(BLOCK).zip(stretch.par_chunks_mut(BLOCK)));
        blocks.enumerate().for_each(|(block, ((mean, scale), (shift, stretch)))| {
            fill(planes, block * BLOCK, [mean, scale, shift, stretch]);
        });
    });
    Moments { numbers, pixels }
}

multiversioned! {
    /// Mean and one over the standard deviation of the pixels from `first` on.
    fn standardize(
        planes: &[f32],
        pixels: usize,
        epsilon: f64,
        first: usize,
        mean: &mut [f32],
        scale: &mut [f32],
    ) {
        let count = (planes.len() / pixels) as f32;
        for plane in planes.chunks_exact(pixels) {
            let plane = &plane[first..][..mean.len()];
            mean.iter_mut().zip(plane).for_each(|(mean, x)| *mean += x);
        }
        mean.iter_mut().for_each(|mean| *mean /= count);
        for plane in planes.chunks_exact(pixels) {
            let plane = &plane[first..][..mean.len()];
            for ((scale, mean), x) in scale.iter_mut().zip(&*mean).zip(plane) {
                *scale += (x - mean) * (x - mean);
            }
        }
        scale.iter_mut().for_each(|scale| *scale = 1.0 / (*scale / count + epsilon as f32).sqrt());
    }
}

multiversioned! {
    /// The mean of gradients, and of their products with what was normalized.
    fn shift_and_stretch(
        both: [&[f32]; 2],
        pixels: usize,
        first: usize,
        moments: [&[f32]; 2],
        shift: &mut [f32],
        stretch: &mut [f32],
    ) {
        let ([planes, grads], [mean, scale]) = (both, moments);
        let count = (planes.len() / pixels) as f32;
        for (plane, grad) in planes.chunks_exact(pixels).zip(grads.chunks_exact(pixels)) {
            let (plane, grad) = (&plane[first..][..mean.len()], &grad[first..][..mean.len()]);
            for i in 0..mean.len() {
                shift[i] += grad[i];
                stretch[i] += grad[i] * ((plane[i] - mean[i]) * scale[i]);
            }
        }
        shift.iter_mut().chain(stretch).for_each(|sum| *sum /= count);
    }
}

multiversioned! {
    fn normalize(plane: &mut [f32], mean: &[f32], scale: &[f32]) {
        for ((x, mean), scale) in plane.iter_mut().zip(mean).zip(scale) {
            *x = (*x - mean) * scale;
        }
    }
}

multiversioned! {
    fn normalize_backward(plane: &mut [f32], grad: &[f32], moments: [&[f32]; 4]) {
        let [mean, scale, shift, stretch] = moments.map(|moment| &moment[..plane.len()]);
        let grad = &grad[..plane.len()];
        for i in 0..plane.len() {
            let normal = (plane[i] - mean[i]) * scale[i];
            plane[i] = scale[i] * (grad[i] - shift[i] - normal * stretch[i]);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
