//! The pooling on tensors: [`max_pool`] with its gradient.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;
use burn::tensor::{IntDType, Tensor};

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

    fn cpu_backward(&self, back: Backprop<CpuTensor, 1>) -> [Option<CpuTensor>; 1] {
        let ([input], grad) = back.into_parts();
        let (size, _) = sizes(&input);
        [Some(input.like(super::max_pool_backward(input.slice(), grad.slice(), size)))]
    }

    fn composed<B: Backend>(&self, [input]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        vec![B::max_pool2d(input, [2; 2], [2; 2], [0; 2], [1; 2], false)]
    }

    fn composed_backward<B: Backend>(
        &self,
        back: Backprop<FloatTensor<B>, 1>,
    ) -> [Option<FloatTensor<B>>; 1] {
        let ([x], grad) = back.into_parts();
        let (side, padding, dilation) = ([2; 2], [0; 2], [1; 2]);
        let pooled =
            B::max_pool2d_with_indices(x.clone(), side, side, padding, dilation, false, IntDType::I32);
        let indices = pooled.indices;
        let gradient =
            B::max_pool2d_with_indices_backward(x, side, side, padding, dilation, false, grad, indices);
        [Some(gradient.x_grad)]
    }
}

/// The largest of each 2x2 pixels of `[batch, channels, height, width]`: `[batch, channels, height / 2, width / 2]`, a last
/// odd row or column left out. The gradient goes to the first of the largest, as in PyTorch.
pub fn max_pool(input: Tensor<4>) -> Tensor<4> {
    apply(MaxPool, [input.into_dispatch()])
}
