//! The definition, in f64.

use super::EPSILON;
use crate::Activation;

/// See [`super::instance_norm`].
pub fn instance_norm(input: &[f32], pixels: usize, activation: Activation) -> Vec<f32> {
    let normalize = |plane: &[f32]| {
        let count = plane.len() as f64;
        let mean = plane.iter().map(|&x| f64::from(x)).sum::<f64>() / count;
        let variance = plane.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / count;
        let deviation = (variance + EPSILON).sqrt();
        plane
            .iter()
            .map(|&x| activation.reference((f64::from(x) - mean) / deviation) as f32)
            .collect::<Vec<_>>()
    };
    input.chunks(pixels).flat_map(normalize).collect()
}
