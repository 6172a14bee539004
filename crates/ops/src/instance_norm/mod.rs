//! Instance normalization (Ulyanov et al. 2016) without learned scale, as in RAFT's feature encoder, fused with the activation
//! that follows; and group normalization (Wu and He 2018), whose planes are all channels of a group. [`mod@reference`] is the
//! definition.

use rayon::prelude::*;
use srflow_simd::{Isa, activate, copy_pieces, multiversioned};

use crate::Activation;
use crate::sums::{sum, sum_pairs};

pub(crate) mod composed;
#[cfg(feature = "cube")]
mod cube;
pub mod reference;
pub mod tensor;

/// Added to the variance; PyTorch's default, also of a batch norm.
pub(crate) const EPSILON: f64 = 1e-5;

/// `activation((x - mean) / sqrt(variance + epsilon))` of each plane of `pixels` elements. Panics when the input is not a whole
/// number of planes.
pub fn instance_norm(input: &[f32], pixels: usize, epsilon: f64, activation: Activation) -> Vec<f32> {
    assert!(pixels > 0 && input.len().is_multiple_of(pixels), "planes of {pixels} pixels");
    let isa = Isa::best();
    copy_pieces(input, pixels, |_, plane| {
        normalize(plane, epsilon);
        if activation != Activation::Identity {
            activate(isa, activation, None, plane);
        }
    })
}

/// Gradient of the input of a normalization without activation, given `grad`, that of its output.
pub fn instance_norm_backward(input: &[f32], grad: &[f32], pixels: usize, epsilon: f64) -> Vec<f32> {
    assert!(pixels > 0 && input.len().is_multiple_of(pixels), "planes of {pixels} pixels");
    assert_eq!(grad.len(), input.len(), "gradient of the output");
    let mut out = vec![0.0; input.len()];
    let planes = input.par_chunks(pixels).zip(grad.par_chunks(pixels));
    out.par_chunks_mut(pixels).zip(planes).for_each(|(to, (from, grad))| {
        let (mean, scale) = statistics(from, epsilon);
        let count = pixels as f64;
        let mean_grad = (sum(grad, |grad| grad) / count) as f32;
        let along = sum_pairs(grad, from, |grad, x| grad * (x - mean) * scale);
        let along = (along / count) as f32;
        for ((to, x), grad) in to.iter_mut().zip(from).zip(grad) {
            *to = scale * (grad - mean_grad - (x - mean) * scale * along);
        }
    });
    out
}

multiversioned! {
    /// `(x - mean) / sqrt(variance + epsilon)` of a plane.
    fn normalize(plane: &mut [f32], epsilon: f64) {
        let (mean, scale) = statistics(plane, epsilon);
        plane.iter_mut().for_each(|x| *x = (*x - mean) * scale);
    }
}

/// The mean of a plane, and the inverse of its standard deviation.
#[inline(always)]
fn statistics(plane: &[f32], epsilon: f64) -> (f32, f32) {
    let count = plane.len() as f64;
    let mean = (sum(plane, |x| x) / count) as f32;
    let variance = sum(plane, |x| (x - mean) * (x - mean)) / count;
    (mean, (1.0 / (variance + epsilon).sqrt()) as f32)
}

#[cfg(test)]
pub(crate) mod tests;
