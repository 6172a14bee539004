use super::tensor::{ConvTranspose2d, shape_of};
use super::*;
use crate::Activation;
use crate::conv2d::tensor::Conv2dOptions;
use crate::operation::tests::{ACTIVATIONS, Case};

/// Input, output channels, kernel, stride, padding.
fn case(
    input: [usize; 4],
    out_channels: usize,
    kernel: [usize; 2],
    [stride, padding]: [[usize; 2]; 2],
    activation: Activation,
) -> Case {
    let weight = [input[1], out_channels, kernel[0], kernel[1]];
    let options = Conv2dOptions::new(stride, padding);
    let shape = shape_of(&options, input.into(), weight.into());
    let products = (input[1] * kernel[0] * kernel[1]) as f32 / (stride[0] * stride[1]) as f32;
    Case::of(
        &format!("{shape:?}, {activation:?}"),
        ConvTranspose2d { options, activation },
        [&input, &weight, &[out_channels]],
        move |x| reference::conv_transpose2d(&x[0], &x[1], &x[2], activation, &shape),
        move |x, grad| {
            reference::conv_transpose2d_backward(&x[0], &x[1], &x[2], activation, grad, &shape).into()
        },
    )
    .change(1, move |_, weight| weight * (3.0 / products).sqrt())
}

/// FlowNet's with every activation, and sizes that leave every kind of remainder. The last is of stride 1.
pub(crate) fn cases() -> Vec<Case> {
    let flownet = [[2, 2], [1, 1]];
    let activations = ACTIVATIONS.map(|activation| case([2, 3, 4, 5], 5, [4, 4], flownet, activation));
    let others = [
        case([1, 1, 1, 1], 2, [4, 4], flownet, Activation::Identity),
        case([1, 18, 3, 9], 17, [4, 4], flownet, Activation::LeakyRelu),
        case([2, 2, 4, 3], 3, [3, 5], [[3, 2], [0, 2]], Activation::Identity),
        case([1, 3, 3, 4], 2, [2, 1], [[3, 2], [0, 0]], Activation::Identity),
        case([2, 16, 6, 7], 17, [3, 3], [[1, 1], [1, 1]], Activation::Tanh),
    ];
    activations.into_iter().chain(others).collect()
}
