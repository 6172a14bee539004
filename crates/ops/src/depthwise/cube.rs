//! Gradients of depthwise convolutions with stride 1 on CubeCL devices. Burn's are made for few groups.

use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

use crate::convolution::Conv2dShape;
use crate::cube::{contiguous, cubes, empty, sum_of_threads, threads};

/// Threads per cube of [`weight_kernel`].
const UNITS: usize = 128;

/// Gradient of the input, from that of the output and the weight.
pub(crate) fn backward_input(grad: &CubeTensor, weight: &CubeTensor, shape: &Conv2dShape) -> CubeTensor {
    let [grad, weight] = [grad, weight].map(|tensor| contiguous(tensor.clone()));
    let out = empty(&grad, shape.input_shape());
    let client = grad.client.clone();
    let (count, dim) = threads(&client, shape.input_shape().iter().product());
    input_kernel::launch(
        &client,
        count,
        dim,
        grad.into_tensor_arg(),
        weight.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        shape.padding[0],
        shape.padding[1],
        shape.kernel[0],
        shape.kernel[1],
    );
    out
}

/// Gradient of the weight, from the input and the gradient of the output.
pub(crate) fn backward_weight(input: &CubeTensor, grad: &CubeTensor, shape: &Conv2dShape) -> CubeTensor {
    let [input, grad] = [input, grad].map(|tensor| contiguous(tensor.clone()));
    let [kernel_height, kernel_width] = shape.kernel;
    let out = empty(&grad, [shape.out_channels, 1, kernel_height, kernel_width]);
    let client = grad.client.clone();
    let (count, dim) = cubes(&client, shape.out_channels * kernel_height, UNITS);
    weight_kernel::launch(
        &client,
        count,
        dim,
        input.into_tensor_arg(),
        grad.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        shape.padding[0],
        shape.padding[1],
        kernel_height,
        kernel_width,
    );
    out
}

/// One thread per element of the input: `[batch, channels, height, width]`, of which neighbours read neighbouring gradients and the same
/// weights. The weight is `[channels, 1, kernel height, kernel width]`.
#[cube(launch)]
fn input_kernel(
    grad: &Tensor<f32>,
    weight: &Tensor<f32>,
    out: &mut Tensor<f32>,
    padding_y: usize,
    padding_x: usize,
    #[comptime] kernel_height: usize,
    #[comptime] kernel_width: usize,
) {
    let (channels, height, width) = (out.shape(1), out.shape(2), out.shape(3));
    if ABSOLUTE_POS >= out.shape(0) * channels * height * width {
        terminate!();
    }
    let (grad_height, grad_width) = (grad.shape(2), grad.shape(3));
    let plane = ABSOLUTE_POS / (height * width);
    let y = ABSOLUTE_POS / width % height + padding_y;
    let x = ABSOLUTE_POS % width + padding_x;
    let taps = plane % channels * kernel_height * kernel_width;
    let mut sum = 0.0f32;
    for row in 0..kernel_height {
        if y >= row && y - row < grad_height {
            let line = (plane * grad_height + y - row) * grad_width;
            for column in 0..kernel_width {
                if x >= column && x - column < grad_width {
                    sum += grad[line + x - column] * weight[taps + row * kernel_width + column];
                }
            }
        }
    }
    out[ABSOLUTE_POS] = sum;
}

/// One cube per channel and row of the kernel. Each thread goes through some of the pixels of all images, for all columns of the row;
/// then the sums of the threads are added in a fixed order. Layouts as in [`input_kernel`].
#[cube(launch)]
#[allow(clippy::manual_is_multiple_of)] // Kernels have no such method.
fn weight_kernel(
    input: &Tensor<f32>,
    grad: &Tensor<f32>,
    out: &mut Tensor<f32>,
    padding_y: usize,
    padding_x: usize,
    #[comptime] kernel_height: usize,
    #[comptime] kernel_width: usize,
) {
    let (batch, channels, height, width) = (input.shape(0), input.shape(1), input.shape(2), input.shape(3));
    let (grad_height, grad_width) = (grad.shape(2), grad.shape(3));
    let channel = CUBE_POS / kernel_height;
    let row = CUBE_POS % kernel_height;
    if channel >= channels {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let mut sums = Array::<f32>::new(kernel_width);
    #[unroll]
    for column in 0..kernel_width {
        sums[column] = 0.0f32;
    }
    for n in 0..batch {
        let plane = n * channels + channel;
        let mut pixel = unit;
        while pixel < grad_height * grad_width {
            let y = pixel / grad_width + row;
            let x = pixel % grad_width;
            if y >= padding_y && y - padding_y < height {
                let line = (plane * height + y - padding_y) * width;
                let value = grad[plane * grad_height * grad_width + pixel];
                #[unroll]
                for column in 0..kernel_width {
                    if x + column >= padding_x && x + column - padding_x < width {
                        sums[column] += value * input[line + x + column - padding_x];
                    }
                }
            }
            pixel += UNITS;
        }
    }
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    #[unroll]
    for column in 0..kernel_width {
        let sum = sum_of_threads(&mut shared, sums[column], UNITS);
        if unit == 0 {
            out[(channel * kernel_height + row) * kernel_width + column] = sum;
        }
    }
}
