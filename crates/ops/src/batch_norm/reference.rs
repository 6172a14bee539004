//! The definition, in f64.

use super::{Affine, BatchNormShape, EPSILON};

/// See [`super::batch_norm`]; the output alone.
pub fn batch_norm(input: &[f32], affine: &Affine, shape: &BatchNormShape) -> Vec<f32> {
    let count = (shape.batch * shape.pixels) as f64;
    let channel_of = |index: usize| index / shape.pixels % shape.channels;
    let (mut mean, mut variance) = (vec![0.0; shape.channels], vec![0.0; shape.channels]);
    for (i, &x) in input.iter().enumerate() {
        mean[channel_of(i)] += f64::from(x) / count;
    }
    for (i, &x) in input.iter().enumerate() {
        variance[channel_of(i)] += (f64::from(x) - mean[channel_of(i)]).powi(2) / count;
    }
    let normalized = |(i, &x): (usize, &f32)| {
        let c = channel_of(i);
        let y = (f64::from(x) - mean[c]) / (variance[c] + EPSILON).sqrt();
        let y = y * f64::from(affine.weight[c]) + f64::from(affine.bias[c]);
        (if affine.relu && y < 0.0 { 0.0 } else { y }) as f32
    };
    input.iter().enumerate().map(normalized).collect()
}
