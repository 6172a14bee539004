//! The normalization composed of a backend's own operations.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::Shape;

use super::EPSILON;
use super::tensor::BatchNorm;
use crate::operation::{Backprop, Composition};

impl Composition<3> for BatchNorm {
    fn composed<B: Backend>(&self, [input, weight, bias]: [FloatTensor<B>; 3]) -> Vec<FloatTensor<B>> {
        let shape = input.shape();
        let channels = weight.shape();
        let rows = rows::<B>(input);
        let mean = B::float_mean_dim(rows.clone(), 1);
        let centred = B::float_sub(rows.clone(), mean.clone());
        let variance = B::float_mean_dim(B::float_mul(centred.clone(), centred), 1);
        let (normal, _) = standardized::<B>(rows, mean.clone(), variance.clone());
        let out = affine::<B>(normal, weight, bias);
        let out = images::<B>(if self.relu { B::relu(out) } else { out }, &shape);
        let [mean, variance] = [mean, variance].map(|column| B::float_reshape(column, channels.clone()));
        vec![out, mean, variance]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 3] {
        let ([input, weight, bias, mean, variance], grad) = back.into_parts();
        let (shape, channels) = (input.shape(), weight.shape());
        let (normal, scale) = standardized::<B>(rows::<B>(input), column::<B>(mean), column::<B>(variance));
        let mut grad = rows::<B>(grad);
        if self.relu {
            let out = B::relu(affine::<B>(normal.clone(), weight.clone(), bias));
            grad = B::relu_backward(out, grad);
        }
        let along = B::float_mul(grad.clone(), normal.clone());
        let d_weight = B::float_reshape(B::float_sum_dim(along.clone(), 1), channels.clone());
        let d_bias = B::float_reshape(B::float_sum_dim(grad.clone(), 1), channels);
        let mean_along = B::float_mul(normal, B::float_mean_dim(along, 1));
        let removed = B::float_add(B::float_mean_dim(grad.clone(), 1), mean_along);
        let scale = B::float_mul(scale, column::<B>(weight));
        let d_input = B::float_mul(B::float_sub(grad, removed), scale);
        [images::<B>(d_input, &shape), d_weight, d_bias].map(Some)
    }
}

/// One row per channel, over all images.
fn rows<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let [batch, channels, height, width] = x.shape().dims();
    B::float_reshape(B::float_swap_dims(x, 0, 1), [channels, batch * height * width].into())
}

/// The adjoint of [`rows`].
fn images<B: Backend>(rows: FloatTensor<B>, shape: &Shape) -> FloatTensor<B> {
    let [batch, channels, height, width] = shape.dims();
    B::float_swap_dims(B::float_reshape(rows, [channels, batch, height, width].into()), 0, 1)
}

/// A number per channel, `[channels, 1]`.
fn column<B: Backend>(values: FloatTensor<B>) -> FloatTensor<B> {
    let channels = values.shape().num_elements();
    B::float_reshape(values, [channels, 1].into())
}

/// Each row minus its mean, divided by its standard deviation; and the inverse of that deviation.
fn standardized<B: Backend>(
    rows: FloatTensor<B>,
    mean: FloatTensor<B>,
    variance: FloatTensor<B>,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let scale = B::float_recip(B::float_sqrt(B::float_add_scalar(variance, EPSILON.into())));
    (B::float_mul(B::float_sub(rows, mean), scale.clone()), scale)
}

fn affine<B: Backend>(
    normal: FloatTensor<B>,
    weight: FloatTensor<B>,
    bias: FloatTensor<B>,
) -> FloatTensor<B> {
    B::float_add(B::float_mul(normal, column::<B>(weight)), column::<B>(bias))
}
