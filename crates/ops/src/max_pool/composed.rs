//! The pooling composed of a backend's own operations.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;
use burn::tensor::IntDType;

use super::tensor::MaxPool;
use crate::operation::{Backprop, Composition};

impl Composition<1> for MaxPool {
    fn composed<B: Backend>(&self, [input]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        vec![B::max_pool2d(input, [2; 2], [2; 2], [0; 2], [1; 2], false)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 1] {
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
