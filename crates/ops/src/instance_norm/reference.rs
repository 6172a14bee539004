//! The definition, in f64.

use crate::Activation;

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Numbers less their mean, over their standard deviation; and that deviation.
pub(crate) fn standardized(values: &[f64], epsilon: f64) -> (Vec<f64>, f64) {
    let centre = mean(values.iter().copied());
    let variance = mean(values.iter().map(|x| (x - centre).powi(2)));
    let deviation = (variance + epsilon).sqrt();
    (values.iter().map(|x| (x - centre) / deviation).collect(), deviation)
}

/// Gradient of the numbers from `grad`, that of their [`standardized`] ones: what would shift all of them, or stretch all of
/// them about their mean, is taken out.
pub(crate) fn standardized_backward(values: &[f64], grad: &[f64], epsilon: f64) -> Vec<f64> {
    let (normal, deviation) = standardized(values, epsilon);
    let shift = mean(grad.iter().copied());
    let stretch = mean(grad.iter().zip(&normal).map(|(grad, x)| grad * x));
    grad.iter().zip(&normal).map(|(grad, x)| (grad - shift - stretch * x) / deviation).collect()
}

/// See [`super::instance_norm`].
pub fn instance_norm(input: &[f64], pixels: usize, epsilon: f64, activation: Activation) -> Vec<f64> {
    let normal = input.chunks(pixels).flat_map(|plane| standardized(plane, epsilon).0);
    normal.map(|x| activation.reference(x)).collect()
}

/// Gradient of the input from `grad`, that of the output of [`instance_norm`].
pub fn instance_norm_backward(
    input: &[f64],
    grad: &[f64],
    pixels: usize,
    epsilon: f64,
    activation: Activation,
) -> Vec<f64> {
    let of_plane = |(plane, grad): (&[f64], &[f64])| {
        let (normal, _) = standardized(plane, epsilon);
        let slopes = normal.iter().map(|&x| activation.reference_derivative(x));
        let d_normal: Vec<f64> = grad.iter().zip(slopes).map(|(grad, slope)| grad * slope).collect();
        standardized_backward(plane, &d_normal, epsilon)
    };
    input.chunks(pixels).zip(grad.chunks(pixels)).flat_map(of_plane).collect()
}
