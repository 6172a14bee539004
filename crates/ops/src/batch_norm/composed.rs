//! The normalization and its gradients by a backend's own operations, for devices that have no kernel of it.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::Shape;

use super::EPSILON;

/// The normalized input, and each channel's mean and variance; see [`super::batch_norm`].
pub(super) fn normalized<B: Backend>(
    [input, weight, bias]: [FloatTensor<B>; 3],
    relu: bool,
) -> [FloatTensor<B>; 3] {
    let shape = input.shape();
    let channels = weight.shape();
    let rows = rows::<B>(input);
    let mean = B::float_mean_dim(rows.clone(), 1);
    let centred = B::float_sub(rows.clone(), mean.clone());
    let variance = B::float_mean_dim(B::float_mul(centred.clone(), centred), 1);
    let (normal, _) = standardized::<B>(rows, mean.clone(), variance.clone());
    let out = affine::<B>(normal, weight, bias);
    let out = if relu { B::relu(out) } else { out };
    [images::<B>(out, &shape), B::float_reshape(mean, channels.clone()), B::float_reshape(variance, channels)]
}

/// Gradients of input, weight and bias; see [`super::batch_norm_backward`].
pub(super) fn gradients<B: Backend>(
    [input, weight, bias, mean, variance]: [FloatTensor<B>; 5],
    relu: bool,
    grad: FloatTensor<B>,
) -> [FloatTensor<B>; 3] {
    let (shape, channels) = (input.shape(), weight.shape());
    let (normal, scale) = standardized::<B>(rows::<B>(input), column::<B>(mean), column::<B>(variance));
    let mut grad = rows::<B>(grad);
    if relu {
        let out = B::relu(affine::<B>(normal.clone(), weight.clone(), bias));
        grad = B::relu_backward(out, grad);
    }
    let along = B::float_mul(grad.clone(), normal.clone());
    let d_weight = B::float_reshape(B::float_sum_dim(along.clone(), 1), channels.clone());
    let d_bias = B::float_reshape(B::float_sum_dim(grad.clone(), 1), channels);
    let removed =
        B::float_add(B::float_mean_dim(grad.clone(), 1), B::float_mul(normal, B::float_mean_dim(along, 1)));
    let scale = B::float_mul(scale, column::<B>(weight));
    let d_input = B::float_mul(B::float_sub(grad, removed), scale);
    [images::<B>(d_input, &shape), d_weight, d_bias]
}

/// One row for each channel, of all images.
fn rows<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    let [batch, channels, height, width] = x.shape().dims();
    B::float_reshape(B::float_swap_dims(x, 0, 1), [channels, batch * height * width].into())
}

/// The adjoint of [`rows`].
fn images<B: Backend>(rows: FloatTensor<B>, shape: &Shape) -> FloatTensor<B> {
    let [batch, channels, height, width] = shape.dims();
    B::float_swap_dims(B::float_reshape(rows, [channels, batch, height, width].into()), 0, 1)
}

/// A number for each channel, `[channels, 1]`.
fn column<B: Backend>(values: FloatTensor<B>) -> FloatTensor<B> {
    let channels = values.shape().num_elements();
    B::float_reshape(values, [channels, 1].into())
}

/// Each row less its mean, over its standard deviation; and one over that deviation.
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
