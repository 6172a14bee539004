//! The pooling on tensors: [`max_pool`] with its gradient.

use burn::tensor::Tensor;

use super::MapSize;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct MaxPool;

/// Sizes of the input, and of what it is pooled to.
fn sizes(input: &CpuTensor) -> (MapSize, [usize; 4]) {
    let [batch, channels, height, width] = input.dims();
    (MapSize { planes: batch * channels, height, width }, [batch, channels, height / 2, width / 2])
}

impl Operation<1> for MaxPool {
    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        let (size, pooled) = sizes(&input);
        vec![CpuTensor::new(super::max_pool(input.slice(), size), pooled)]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        let (size, _) = sizes(&input);
        [Some(input.like(super::max_pool_backward(input.slice(), grad.slice(), size)))]
    }
}

/// The largest of each 2x2 pixels of `[batch, channels, height, width]`: `[batch, channels, height / 2, width / 2]`, a last
/// odd row or column left out. The gradient goes to the first of the largest, as in PyTorch.
pub fn max_pool(input: Tensor<4>) -> Tensor<4> {
    apply(MaxPool, [input.into_dispatch()])
}
