//! The definition of convolutions, dense and depthwise, and of what becomes of their sums: plain loops, in f64.

use super::Conv2dShape;
use crate::Activation;

/// What goes into a convolution, and what is done with its sums. Layouts: see [`Conv2dShape`].
#[derive(Debug, Clone, Copy)]
pub struct Operands<'a> {
    pub input: &'a [f64],
    pub weight: &'a [f64],
    /// `[out_channels]`.
    pub bias: &'a [f64],
    /// Of the output's shape.
    pub residual: Option<&'a [f64]>,
    /// Applied last.
    pub activation: Activation,
}

/// Calls `visit(weight, input, output)`, places in the whole arrays, for each product that is a part of an output.
fn each_product(shape: &Conv2dShape, mut visit: impl FnMut(usize, usize, usize)) {
    let Conv2dShape { batch, in_channels, groups, input: [height, width], stride, padding, .. } = *shape;
    let [out_channels, inputs, kernel_height, kernel_width] = shape.weight();
    let [out_height, out_width] = shape.output();
    for (n, o) in pairs(batch, out_channels) {
        let group = o / (out_channels / groups);
        for (y, x) in pairs(out_height, out_width) {
            for c in 0..inputs {
                for (i, j) in pairs(kernel_height, kernel_width) {
                    let row = (y * stride[0] + i).checked_sub(padding[0]).filter(|&row| row < height);
                    let column = (x * stride[1] + j).checked_sub(padding[1]).filter(|&column| column < width);
                    let (Some(row), Some(column)) = (row, column) else { continue };
                    let plane = n * in_channels + group * inputs + c;
                    visit(
                        ((o * inputs + c) * kernel_height + i) * kernel_width + j,
                        (plane * height + row) * width + column,
                        ((n * out_channels + o) * out_height + y) * out_width + x,
                    );
                }
            }
        }
    }
}

fn pairs(rows: usize, columns: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..rows).flat_map(move |row| (0..columns).map(move |column| (row, column)))
}

/// The channel that an output element belongs to.
fn channel_of(output: usize, shape: &Conv2dShape) -> usize {
    let [height, width] = shape.output();
    output / (height * width) % shape.out_channels
}

/// What the activation is applied to.
fn sums(of: &Operands, shape: &Conv2dShape) -> Vec<f64> {
    let added =
        |output| of.bias[channel_of(output, shape)] + of.residual.map_or(0.0, |residual| residual[output]);
    let mut sums: Vec<f64> = (0..shape.output_len()).map(added).collect();
    each_product(shape, |w, i, o| sums[o] += of.weight[w] * of.input[i]);
    sums
}

/// See [`crate::conv2d::conv2d`] and [`crate::depthwise::depthwise`].
pub fn convolve(of: &Operands, shape: &Conv2dShape) -> Vec<f64> {
    sums(of, shape).into_iter().map(|sum| of.activation.reference(sum)).collect()
}

/// Gradients of input, weight, bias and residual from `grad`, that of the output.
pub fn convolve_backward(of: &Operands, grad: &[f64], shape: &Conv2dShape) -> [Vec<f64>; 4] {
    let slopes = sums(of, shape).into_iter().map(|sum| of.activation.reference_derivative(sum));
    let grad: Vec<f64> = grad.iter().zip(slopes).map(|(grad, slope)| grad * slope).collect();
    let d_input = backward_input(&grad, of.weight, shape);
    let d_weight = backward_weight(of.input, &grad, shape);
    [d_input, d_weight, backward_bias(&grad, shape), grad]
}

/// Gradient of the input from `grad`, that of the sums.
pub fn backward_input(grad: &[f64], weight: &[f64], shape: &Conv2dShape) -> Vec<f64> {
    let mut d_input = vec![0.0; shape.input_len()];
    each_product(shape, |w, i, o| d_input[i] += weight[w] * grad[o]);
    d_input
}

/// Gradient of the weight from `grad`, that of the sums.
pub fn backward_weight(input: &[f64], grad: &[f64], shape: &Conv2dShape) -> Vec<f64> {
    let mut d_weight = vec![0.0; shape.weight_len()];
    each_product(shape, |w, i, o| d_weight[w] += input[i] * grad[o]);
    d_weight
}

/// Gradient of the bias from `grad`, that of the sums; see [`crate::conv2d::conv2d_backward_bias`].
pub fn backward_bias(grad: &[f64], shape: &Conv2dShape) -> Vec<f64> {
    let mut d_bias = vec![0.0; shape.out_channels];
    for (output, grad) in grad.iter().enumerate() {
        d_bias[channel_of(output, shape)] += grad;
    }
    d_bias
}
