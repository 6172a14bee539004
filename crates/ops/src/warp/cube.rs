//! The warp on CubeCL devices.
//!
//! Neighbouring threads process neighbouring pixels of one plane, so that reads of the flow and writes are contiguous, and reads of
//! the image nearly so where the flow is smooth.

use burn::backend::TensorMetadata;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

use crate::cube::{AtomicAdd, ByExchange, InOneStep, adds_in_one_step, contiguous, empty, threads, zeros};

pub(super) fn warp(inputs: [CubeTensor; 2]) -> CubeTensor {
    let [image, flow] = inputs.map(contiguous);
    let out = empty(&image, image.shape());
    let client = image.client.clone();
    let (count, dim) = threads(&client, out.shape().num_elements());
    warp_kernel::launch(
        &client,
        count,
        dim,
        image.into_tensor_arg(),
        flow.into_tensor_arg(),
        out.clone().into_tensor_arg(),
    );
    out
}

/// Gradients of image and flow.
pub(super) fn warp_backward(inputs: [CubeTensor; 2], grad: CubeTensor) -> [CubeTensor; 2] {
    let ([image, flow], grad) = (inputs.map(contiguous), contiguous(grad));
    let (d_image, d_flow) = (zeros(&image, image.shape()), empty(&flow, flow.shape()));
    let client = image.client.clone();
    let launch = match adds_in_one_step(&client) {
        true => gradient_kernel::launch::<InOneStep>,
        false => gradient_kernel::launch::<ByExchange>,
    };
    let (count, dim) = threads(&client, flow.shape().num_elements() / 2);
    launch(
        &client,
        count,
        dim,
        image.into_tensor_arg(),
        flow.into_tensor_arg(),
        grad.into_tensor_arg(),
        d_image.clone().into_tensor_arg(),
        d_flow.clone().into_tensor_arg(),
    );
    [d_image, d_flow]
}

/// One thread per element of the image: one per pixel would leave most of the device idle for a small map with many channels.
/// Layouts: image and out `[batch, channels, height, width]`, flow `[batch, 2, height, width]`.
#[cube(launch)]
fn warp_kernel(image: &Tensor<f32>, flow: &Tensor<f32>, out: &mut Tensor<f32>) {
    let (channels, height, width) = (image.shape(1), image.shape(2), image.shape(3));
    if ABSOLUTE_POS >= image.shape(0) * channels * height * width {
        terminate!();
    }
    let pixels = height * width;
    let plane = ABSOLUTE_POS / pixels;
    let at = ABSOLUTE_POS % pixels;
    let u = plane / channels * 2 * pixels + at;
    let x = f32::cast_from(at % width) + flow[u];
    let y = f32::cast_from(at / width) + flow[u + pixels];
    let (left, top) = (x.floor(), y.floor());
    let (right, below) = (x - left, y - top);
    let (start, size) = (plane * pixels, (height, width));
    let upper = value(image, start, left, top, size) * (1.0 - right)
        + value(image, start, left + 1.0, top, size) * right;
    let lower = value(image, start, left, top + 1.0, size) * (1.0 - right)
        + value(image, start, left + 1.0, top + 1.0, size) * right;
    out[ABSOLUTE_POS] = upper * (1.0 - below) + lower * below;
}

/// One thread per pixel, which iterates over the channels: the gradient of its flow is their sum. The gradient of the image is
/// scattered to the sampled positions. Layouts as in [`warp_kernel`].
#[cube(launch)]
fn gradient_kernel<A: AtomicAdd>(
    image: &Tensor<f32>,
    flow: &Tensor<f32>,
    grad: &Tensor<f32>,
    d_image: &mut Tensor<Atomic<A::Cell>>,
    d_flow: &mut Tensor<f32>,
) {
    let (channels, height, width) = (image.shape(1), image.shape(2), image.shape(3));
    let pixels = height * width;
    if ABSOLUTE_POS >= image.shape(0) * pixels {
        terminate!();
    }
    let n = ABSOLUTE_POS / pixels;
    let at = ABSOLUTE_POS % pixels;
    let u = n * 2 * pixels + at;
    let x = f32::cast_from(at % width) + flow[u];
    let y = f32::cast_from(at / width) + flow[u + pixels];
    let (left, top) = (x.floor(), y.floor());
    let (right, below) = (x - left, y - top);
    let size = (height, width);
    let mut du = 0.0;
    let mut dv = 0.0;
    for c in 0..channels {
        let start = (n * channels + c) * pixels;
        let grad = grad[start + at];
        let a = value(image, start, left, top, size);
        let b = value(image, start, left + 1.0, top, size);
        let c = value(image, start, left, top + 1.0, size);
        let d = value(image, start, left + 1.0, top + 1.0, size);
        du += grad * ((b - a) * (1.0 - below) + (d - c) * below);
        dv += grad * ((c - a) * (1.0 - right) + (d - b) * right);
        scatter::<A>(d_image, start, left, top, size, (1.0 - right) * (1.0 - below) * grad);
        scatter::<A>(d_image, start, left + 1.0, top, size, right * (1.0 - below) * grad);
        scatter::<A>(d_image, start, left, top + 1.0, size, (1.0 - right) * below * grad);
        scatter::<A>(d_image, start, left + 1.0, top + 1.0, size, right * below * grad);
    }
    d_flow[u] = du;
    d_flow[u + pixels] = dv;
}

/// Compared as floats before any cast: a flow may have any value, including NaN.
#[cube]
fn inside(x: f32, y: f32, size: (usize, usize)) -> bool {
    let (height, width) = size;
    x >= 0.0 && y >= 0.0 && x < f32::cast_from(width) && y < f32::cast_from(height)
}

/// The pixel at integer coordinates `x` and `y` of the plane that begins at `start`, zero outside.
#[cube]
fn value(image: &Tensor<f32>, start: usize, x: f32, y: f32, size: (usize, usize)) -> f32 {
    let mut value = 0.0;
    if inside(x, y, size) {
        value = image[start + usize::cast_from(y) * size.1 + usize::cast_from(x)];
    }
    value
}

/// The adjoint of [`value`].
#[cube]
fn scatter<A: AtomicAdd>(
    to: &mut Tensor<Atomic<A::Cell>>,
    start: usize,
    x: f32,
    y: f32,
    size: (usize, usize),
    value: f32,
) {
    if inside(x, y, size) {
        A::add(&mut to[start + usize::cast_from(y) * size.1 + usize::cast_from(x)], value);
    }
}
