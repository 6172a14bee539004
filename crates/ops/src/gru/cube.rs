//! The steps on CubeCL devices, each in one kernel, and its gradients in another: composed, the gates would be cut in two and the parts
//! multiplied, added and joined in up to seven.
//!
//! One thread per element of the hidden state, `[batch, channels, height, width]`: neighbours read and write neighbouring numbers. Gates are
//! `[batch, 2 channels, height, width]`.

use burn::backend::TensorMetadata;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

use crate::cube::{contiguous, empty, threads};

pub(super) fn reset(inputs: [CubeTensor; 2]) -> CubeTensor {
    let [gates, hidden] = inputs.map(contiguous);
    let out = empty(&hidden, hidden.shape());
    let client = hidden.client.clone();
    let (count, dim) = threads(&client, hidden.shape().num_elements());
    reset_kernel::launch(
        &client,
        count,
        dim,
        gates.into_tensor_arg(),
        hidden.into_tensor_arg(),
        out.clone().into_tensor_arg(),
    );
    out
}

/// Gradients of gates and hidden state.
pub(super) fn reset_backward(inputs: [CubeTensor; 2], grad: CubeTensor) -> [CubeTensor; 2] {
    let ([gates, hidden], grad) = (inputs.map(contiguous), contiguous(grad));
    let gradients = [&gates, &hidden].map(|input| empty(input, input.shape()));
    let [d_gates, d_hidden] = gradients.clone();
    let client = hidden.client.clone();
    let (count, dim) = threads(&client, hidden.shape().num_elements());
    reset_gradient_kernel::launch(
        &client,
        count,
        dim,
        gates.into_tensor_arg(),
        hidden.into_tensor_arg(),
        grad.into_tensor_arg(),
        d_gates.into_tensor_arg(),
        d_hidden.into_tensor_arg(),
    );
    gradients
}

pub(super) fn update(inputs: [CubeTensor; 3]) -> CubeTensor {
    let [gates, hidden, candidate] = inputs.map(contiguous);
    let out = empty(&hidden, hidden.shape());
    let client = hidden.client.clone();
    let (count, dim) = threads(&client, hidden.shape().num_elements());
    update_kernel::launch(
        &client,
        count,
        dim,
        gates.into_tensor_arg(),
        hidden.into_tensor_arg(),
        candidate.into_tensor_arg(),
        out.clone().into_tensor_arg(),
    );
    out
}

/// Gradients of gates, hidden state and candidate.
pub(super) fn update_backward(inputs: [CubeTensor; 3], grad: CubeTensor) -> [CubeTensor; 3] {
    let ([gates, hidden, candidate], grad) = (inputs.map(contiguous), contiguous(grad));
    let gradients = [&gates, &hidden, &candidate].map(|input| empty(input, input.shape()));
    let [d_gates, d_hidden, d_candidate] = gradients.clone();
    let client = hidden.client.clone();
    let (count, dim) = threads(&client, hidden.shape().num_elements());
    update_gradient_kernel::launch(
        &client,
        count,
        dim,
        gates.into_tensor_arg(),
        hidden.into_tensor_arg(),
        candidate.into_tensor_arg(),
        grad.into_tensor_arg(),
        d_gates.into_tensor_arg(),
        d_hidden.into_tensor_arg(),
        d_candidate.into_tensor_arg(),
    );
    gradients
}

/// Elements of an image of the hidden state.
#[cube]
fn image_of(hidden: &Tensor<f32>) -> usize {
    hidden.shape(1) * hidden.shape(2) * hidden.shape(3)
}

/// Where the update gate of element `index` of the hidden state is; its reset gate is one image further.
#[cube]
fn update_gate_of(index: usize, image: usize) -> usize {
    index / image * 2 * image + index % image
}

#[cube(launch)]
fn reset_kernel(gates: &Tensor<f32>, hidden: &Tensor<f32>, out: &mut Tensor<f32>) {
    let image = image_of(hidden);
    if ABSOLUTE_POS >= hidden.shape(0) * image {
        terminate!();
    }
    out[ABSOLUTE_POS] = gates[update_gate_of(ABSOLUTE_POS, image) + image] * hidden[ABSOLUTE_POS];
}

#[cube(launch)]
fn reset_gradient_kernel(
    gates: &Tensor<f32>,
    hidden: &Tensor<f32>,
    grad: &Tensor<f32>,
    d_gates: &mut Tensor<f32>,
    d_hidden: &mut Tensor<f32>,
) {
    let image = image_of(hidden);
    if ABSOLUTE_POS >= hidden.shape(0) * image {
        terminate!();
    }
    let gate = update_gate_of(ABSOLUTE_POS, image);
    let grad = grad[ABSOLUTE_POS];
    d_gates[gate] = 0.0f32;
    d_gates[gate + image] = grad * hidden[ABSOLUTE_POS];
    d_hidden[ABSOLUTE_POS] = grad * gates[gate + image];
}

#[cube(launch)]
fn update_kernel(gates: &Tensor<f32>, hidden: &Tensor<f32>, candidate: &Tensor<f32>, out: &mut Tensor<f32>) {
    let image = image_of(hidden);
    if ABSOLUTE_POS >= hidden.shape(0) * image {
        terminate!();
    }
    let before = hidden[ABSOLUTE_POS];
    let way = candidate[ABSOLUTE_POS] - before;
    out[ABSOLUTE_POS] = before + gates[update_gate_of(ABSOLUTE_POS, image)] * way;
}

#[cube(launch)]
fn update_gradient_kernel(
    gates: &Tensor<f32>,
    hidden: &Tensor<f32>,
    candidate: &Tensor<f32>,
    grad: &Tensor<f32>,
    d_gates: &mut Tensor<f32>,
    d_hidden: &mut Tensor<f32>,
    d_candidate: &mut Tensor<f32>,
) {
    let image = image_of(hidden);
    if ABSOLUTE_POS >= hidden.shape(0) * image {
        terminate!();
    }
    let gate = update_gate_of(ABSOLUTE_POS, image);
    let grad = grad[ABSOLUTE_POS];
    let update = gates[gate];
    d_gates[gate] = grad * (candidate[ABSOLUTE_POS] - hidden[ABSOLUTE_POS]);
    d_gates[gate + image] = 0.0f32;
    d_hidden[ABSOLUTE_POS] = grad * (1.0f32 - update);
    d_candidate[ABSOLUTE_POS] = grad * update;
}
