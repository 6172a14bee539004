use burn::backend::DispatchTensor;

use super::reference::Operands;
use super::*;
use crate::operation::tests::{Case, Composed};

/// What is added to the sums beside the bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Residual {
    None,
    Other,
    /// The input itself.
    Input,
}

/// A convolution with a bias, and with weights that keep its sums of the size of its inputs.
pub(crate) fn case(kernels: Kernels, shape: Conv2dShape, activation: Activation, residual: Residual) -> Case {
    let Conv2dShape { batch, in_channels, out_channels, input: [height, width], .. } = shape;
    let (input, weight) = ([batch, in_channels, height, width], shape.weight());
    let (bias, output) = ([out_channels], shape.output_shape());
    let mut shapes: Vec<&[usize]> = vec![&input, &weight, &bias];
    if residual == Residual::Other {
        shapes.push(&output);
    }
    let options = Conv2dOptions::new(shape.stride, shape.padding);
    let kernel = Convolution { kernels, options, activation };
    let composed = Composed(kernel.clone());
    let products = weight[1..].iter().product::<usize>() as f32;
    Case::new(
        &format!("{shape:?}, {activation:?}, residual: {residual:?}"),
        &shapes,
        move |inputs| convolved(&kernel, inputs, residual),
        move |x| reference::convolve(&operands(x, activation, residual), &shape),
        move |x, grad| {
            let [mut d_input, d_weight, d_bias, d_residual] =
                reference::convolve_backward(&operands(x, activation, residual), grad, &shape);
            match residual {
                Residual::None => vec![d_input, d_weight, d_bias],
                Residual::Other => vec![d_input, d_weight, d_bias, d_residual],
                Residual::Input => {
                    d_input.iter_mut().zip(&d_residual).for_each(|(to, from)| *to += from);
                    vec![d_input, d_weight, d_bias]
                }
            }
        },
    )
    .or(move |inputs| convolved(&composed, inputs, residual))
    .change(1, move |_, weight| weight * (3.0 / products).sqrt())
}

fn convolved<O: Operation<3> + Operation<4>>(
    operation: &O,
    mut inputs: Vec<DispatchTensor>,
    residual: Residual,
) -> Tensor<4> {
    if residual == Residual::Input {
        inputs.push(inputs[0].clone());
    }
    match residual {
        Residual::None => apply::<O, 3, 4>(operation.clone(), array(inputs)),
        Residual::Other | Residual::Input => apply::<O, 4, 4>(operation.clone(), array(inputs)),
    }
}

fn operands(x: &[Vec<f64>], activation: Activation, residual: Residual) -> Operands<'_> {
    let residual = match residual {
        Residual::None => None,
        Residual::Other => Some(&x[3][..]),
        Residual::Input => Some(&x[0][..]),
    };
    Operands { input: &x[0], weight: &x[1], bias: &x[2], residual, activation }
}
