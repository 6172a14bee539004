//! The definition, in f64: one channel after another.

use crate::instance_norm::EPSILON;
use crate::instance_norm::reference::{standardized, standardized_backward};
use crate::{Activation, MapShape};

/// What goes into a normalization: input, weight and bias.
type Inputs<'a> = [&'a [f64]; 3];

/// Where the elements of a channel are.
fn elements_of(channel: usize, shape: &MapShape) -> Vec<usize> {
    let all = 0..shape.elements();
    all.filter(|element| element / shape.pixels() % shape.channels == channel).collect()
}

fn activation(relu: bool) -> Activation {
    if relu { Activation::Relu } else { Activation::Identity }
}

/// See [`super::batch_norm`]; the output alone.
pub fn batch_norm([input, weight, bias]: Inputs, relu: bool, shape: &MapShape) -> Vec<f64> {
    let mut out = vec![0.0; input.len()];
    for channel in 0..shape.channels {
        let elements = elements_of(channel, shape);
        let values: Vec<f64> = elements.iter().map(|&i| input[i]).collect();
        for (i, normal) in elements.into_iter().zip(standardized(&values, EPSILON).0) {
            out[i] = activation(relu).reference(weight[channel] * normal + bias[channel]);
        }
    }
    out
}

/// See [`super::batch_norm_backward`]: gradients of input, weight and bias.
pub fn batch_norm_backward(
    [input, weight, bias]: Inputs,
    grad: &[f64],
    relu: bool,
    shape: &MapShape,
) -> [Vec<f64>; 3] {
    let mut d_input = vec![0.0; input.len()];
    let [mut d_weight, mut d_bias] = [vec![0.0; weight.len()], vec![0.0; bias.len()]];
    for channel in 0..shape.channels {
        let elements = elements_of(channel, shape);
        let values: Vec<f64> = elements.iter().map(|&i| input[i]).collect();
        let mut d_normal = Vec::new();
        for (&i, normal) in elements.iter().zip(standardized(&values, EPSILON).0) {
            let d_affine =
                grad[i] * activation(relu).reference_derivative(weight[channel] * normal + bias[channel]);
            d_weight[channel] += d_affine * normal;
            d_bias[channel] += d_affine;
            d_normal.push(d_affine * weight[channel]);
        }
        for (i, gradient) in elements.into_iter().zip(standardized_backward(&values, &d_normal, EPSILON)) {
            d_input[i] = gradient;
        }
    }
    [d_input, d_weight, d_bias]
}
