//! The normalization on CubeCL devices: one cube of threads per plane, in one kernel each for forward and backward, which sum in a fixed
//! order.

use burn::backend::TensorMetadata;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

use crate::cube::{contiguous, cubes, empty, sum_of_threads};

/// Threads per cube.
const UNITS: usize = 256;

/// `below` is the slope of the activation under zero, which above is 1: 1 for none, 0 for ReLU.
pub(super) fn instance_norm(input: CubeTensor, epsilon: f64, below: f32) -> CubeTensor {
    let input = contiguous(input);
    let [batch, channels, _, _] = input.shape().dims();
    let out = empty(&input, input.shape());
    let client = input.client.clone();
    let (count, dim) = cubes(&client, batch * channels, UNITS);
    norm_kernel::launch(
        &client,
        count,
        dim,
        input.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        epsilon as f32,
        below,
    );
    out
}

/// Gradient of the input of a normalization without activation, from that of its output.
pub(super) fn instance_norm_backward(input: CubeTensor, grad: CubeTensor, epsilon: f64) -> CubeTensor {
    let [input, grad] = [input, grad].map(contiguous);
    let [batch, channels, _, _] = input.shape().dims();
    let out = empty(&input, input.shape());
    let client = input.client.clone();
    let (count, dim) = cubes(&client, batch * channels, UNITS);
    gradient_kernel::launch(
        &client,
        count,
        dim,
        input.into_tensor_arg(),
        grad.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        epsilon as f32,
    );
    out
}

/// The mean of the plane that begins at `start`, and the inverse of its standard deviation.
#[cube]
fn statistics(
    input: &Tensor<f32>,
    sums: &mut [f32],
    start: usize,
    pixels: usize,
    epsilon: f32,
) -> (f32, f32) {
    // Distances from a number of the plane: its mean may be far larger than its spread.
    let origin = input[start];
    let mut own = 0.0f32;
    let mut at = UNIT_POS as usize;
    while at < pixels {
        own += input[start + at] - origin;
        at += UNITS;
    }
    let count = f32::cast_from(pixels);
    let mean = origin + sum_of_threads(sums, own, UNITS) / count;
    let mut own = 0.0f32;
    let mut at = UNIT_POS as usize;
    while at < pixels {
        let distance = input[start + at] - mean;
        own += distance * distance;
        at += UNITS;
    }
    let variance = sum_of_threads(sums, own, UNITS) / count;
    (mean, 1.0f32 / (variance + epsilon).sqrt())
}

#[cube(launch)]
fn norm_kernel(input: &Tensor<f32>, out: &mut Tensor<f32>, epsilon: f32, below: f32) {
    let plane = CUBE_POS;
    if plane >= input.shape(0) * input.shape(1) {
        terminate!();
    }
    let pixels = input.shape(2) * input.shape(3);
    let start = plane * pixels;
    let mut sums = Shared::<[f32]>::new_slice(comptime!(UNITS));
    let (mean, scale) = statistics(input, &mut sums, start, pixels, epsilon);
    let mut at = UNIT_POS as usize;
    while at < pixels {
        let mut normal = (input[start + at] - mean) * scale;
        if normal < 0.0f32 {
            normal *= below;
        }
        out[start + at] = normal;
        at += UNITS;
    }
}

#[cube(launch)]
fn gradient_kernel(input: &Tensor<f32>, grad: &Tensor<f32>, out: &mut Tensor<f32>, epsilon: f32) {
    let plane = CUBE_POS;
    if plane >= input.shape(0) * input.shape(1) {
        terminate!();
    }
    let pixels = input.shape(2) * input.shape(3);
    let start = plane * pixels;
    let mut sums = Shared::<[f32]>::new_slice(comptime!(UNITS));
    let (mean, scale) = statistics(input, &mut sums, start, pixels, epsilon);
    let mut own = 0.0f32;
    let mut own_along = 0.0f32;
    let mut at = UNIT_POS as usize;
    while at < pixels {
        let grad = grad[start + at];
        own += grad;
        own_along += grad * (input[start + at] - mean) * scale;
        at += UNITS;
    }
    let count = f32::cast_from(pixels);
    let shift = sum_of_threads(&mut sums, own, UNITS) / count;
    let stretch = sum_of_threads(&mut sums, own_along, UNITS) / count;
    let mut at = UNIT_POS as usize;
    while at < pixels {
        let normal = (input[start + at] - mean) * scale;
        out[start + at] = (grad[start + at] - shift - normal * stretch) * scale;
        at += UNITS;
    }
}
