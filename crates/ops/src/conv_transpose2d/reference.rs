//! The definition: every element of the input adds its multiple of the kernel to the output, in f64.

use crate::Activation;
use crate::convolution::Conv2dShape;
use crate::convolution::reference::{self as convolution, Operands};

/// `activation(sums + bias)`, `[batch, in_channels, height, width]` of the convolution of this `shape`, whose output has the
/// input's size.
pub fn conv_transpose2d(
    input: &[f64],
    weight: &[f64],
    bias: &[f64],
    activation: Activation,
    shape: &Conv2dShape,
) -> Vec<f64> {
    sums(input, weight, bias, shape).into_iter().map(|sum| activation.reference(sum)).collect()
}

/// Gradients of input, weight and bias from `grad`, that of the output.
pub fn conv_transpose2d_backward(
    input: &[f64],
    weight: &[f64],
    bias: &[f64],
    activation: Activation,
    grad: &[f64],
    shape: &Conv2dShape,
) -> [Vec<f64>; 3] {
    let slopes = sums(input, weight, bias, shape).into_iter().map(|sum| activation.reference_derivative(sum));
    let grad: Vec<f64> = grad.iter().zip(slopes).map(|(grad, slope)| grad * slope).collect();
    let no_bias = vec![0.0; shape.out_channels];
    let transposed =
        Operands { input: &grad, weight, bias: &no_bias, residual: None, activation: Activation::Identity };
    let mut d_bias = vec![0.0; shape.in_channels];
    for (plane, grad) in grad.chunks(shape.input[0] * shape.input[1]).enumerate() {
        d_bias[plane % shape.in_channels] += grad.iter().sum::<f64>();
    }
    [convolution::convolve(&transposed, shape), convolution::backward_weight(&grad, input, shape), d_bias]
}

fn sums(input: &[f64], weight: &[f64], bias: &[f64], shape: &Conv2dShape) -> Vec<f64> {
    let mut sums = convolution::backward_input(input, weight, shape);
    for (plane, sums) in sums.chunks_mut(shape.input[0] * shape.input[1]).enumerate() {
        sums.iter_mut().for_each(|sum| *sum += bias[plane % shape.in_channels]);
    }
    sums
}
