//! The pooling on tensors: [`max_pool`] with its gradient.

use burn::tensor::Tensor;

use super::pooled;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct MaxPool;

impl Operation<1> for MaxPool {
    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        let size = input.map_shape();
        vec![CpuTensor::new(super::max_pool(input.slice(), size), pooled(size).dims())]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        [Some(input.like(super::max_pool_backward(input.slice(), grad.slice(), input.map_shape())))]
    }
}

/// The largest of each 2x2 pixels of `[batch, channels, height, width]`: `[batch, channels, height / 2, width / 2]`, a last
/// odd row or column left out. The gradient goes to the first of the largest, as in PyTorch.
pub fn max_pool(input: Tensor<4>) -> Tensor<4> {
    apply(MaxPool, [input.into_dispatch()])
}
