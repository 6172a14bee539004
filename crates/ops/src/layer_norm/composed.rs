//! The normalization by a backend's own operations.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;

use super::tensor::LayerNorm;
use crate::activation::activate_tensor;
use crate::instance_norm::composed::{standardized, standardized_backward};
use crate::operation::{Backprop, Composition};

impl Composition<1> for LayerNorm {
    fn composed<B: Backend>(&self, [input]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        let (normal, _) = standardized::<B>(input, self.epsilon);
        vec![activate_tensor::<B>(normal, self.activation)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 1] {
        let ([input], grad) = back.into_parts();
        [Some(standardized_backward::<B>(input, grad, self.epsilon))]
    }
}
