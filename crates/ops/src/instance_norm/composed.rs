//! The normalization composed of a backend's own operations.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};

use super::tensor::InstanceNorm;
use crate::activation::activate_tensor;
use crate::operation::{Backprop, Composition};

impl Composition<1> for InstanceNorm {
    fn composed<B: Backend>(&self, [input]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        let shape = input.shape();
        let (normal, _) = standardized::<B>(planes::<B>(input), self.epsilon);
        vec![activate_tensor::<B>(B::float_reshape(normal, shape), self.activation)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 1] {
        let ([input], grad) = back.into_parts();
        let shape = input.shape();
        let gradient = standardized_backward::<B>(planes::<B>(input), planes::<B>(grad), self.epsilon);
        [Some(B::float_reshape(gradient, shape))]
    }
}

/// One row per channel of each image.
fn planes<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let [batch, channels, height, width] = x.shape().dims();
    B::float_reshape(x, [batch * channels, height * width].into())
}

/// What lies along the second dimension minus its mean, divided by its standard deviation; and the inverse of that deviation.
pub(crate) fn standardized<B: Backend>(x: FloatTensor<B>, epsilon: f64) -> (FloatTensor<B>, FloatTensor<B>) {
    let mean = B::float_mean_dim(x.clone(), 1);
    let centred = B::float_sub(x, mean);
    let variance = B::float_mean_dim(B::float_mul(centred.clone(), centred.clone()), 1);
    let scale = B::float_recip(B::float_sqrt(B::float_add_scalar(variance, epsilon.into())));
    (B::float_mul(centred, scale.clone()), scale)
}

/// Gradient of what was [`standardized`] from that of its first output.
pub(crate) fn standardized_backward<B: Backend>(
    x: FloatTensor<B>,
    grad: FloatTensor<B>,
    epsilon: f64,
) -> FloatTensor<B> {
    let (normal, scale) = standardized::<B>(x, epsilon);
    let mean = B::float_mean_dim(grad.clone(), 1);
    let along = B::float_mean_dim(B::float_mul(grad.clone(), normal.clone()), 1);
    let removed = B::float_add(mean, B::float_mul(normal, along));
    B::float_mul(B::float_sub(grad, removed), scale)
}
