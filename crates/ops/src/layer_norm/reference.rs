//! The definition, in f64.

use crate::instance_norm::reference::{instance_norm, instance_norm_backward};
use crate::{Activation, MapShape};

/// See [`super::layer_norm`]: every pixel's channels are a plane of their own.
pub fn layer_norm(input: &[f64], shape: &MapShape, epsilon: f64, activation: Activation) -> Vec<f64> {
    let (channels, pixels) = (shape.channels, shape.pixels());
    let normal = instance_norm(&transposed(input, channels, pixels), channels, epsilon, activation);
    transposed(&normal, pixels, channels)
}

/// Gradient of the input from `grad`, that of the output of [`layer_norm`].
pub fn layer_norm_backward(
    input: &[f64],
    grad: &[f64],
    shape: &MapShape,
    epsilon: f64,
    activation: Activation,
) -> Vec<f64> {
    let (channels, pixels) = (shape.channels, shape.pixels());
    let [input, grad] = [input, grad].map(|values| transposed(values, channels, pixels));
    let gradient = instance_norm_backward(&input, &grad, channels, epsilon, activation);
    transposed(&gradient, pixels, channels)
}

/// Rows of each image as columns.
fn transposed(values: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    let of_image = |image: &[f64]| -> Vec<f64> {
        (0..rows * columns).map(|i| image[i % rows * columns + i / rows]).collect()
    };
    values.chunks(rows * columns).flat_map(of_image).collect()
}
