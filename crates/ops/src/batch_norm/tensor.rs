//! The normalization on tensors: [`batch_norm`] with its gradients.

use burn::tensor::Tensor;

use super::{Affine, Statistics};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, array, outputs};

/// Share of a batch's statistics in the running ones; PyTorch's default.
const MOMENTUM: f64 = 0.1;

/// Of input, weight and bias; gives each channel's mean and variance beside the output.
#[derive(Debug, Clone)]
pub(super) struct BatchNorm {
    pub(super) relu: bool,
}

impl BatchNorm {
    fn affine<'a>(&self, weight: &'a CpuTensor, bias: &'a CpuTensor) -> Affine<'a> {
        Affine { weight: weight.slice(), bias: bias.slice(), relu: self.relu }
    }
}

impl Operation<3> for BatchNorm {
    fn saved_outputs<T>(outputs: &[T]) -> &[T] {
        &outputs[1..]
    }

    fn cpu(&self, [input, weight, bias]: [CpuTensor; 3]) -> Vec<CpuTensor> {
        let (affine, shape) = (self.affine(&weight, &bias), input.map_shape());
        let (out, Statistics { mean, variance }) = super::batch_norm(input.slice(), &affine, &shape);
        vec![input.like(out), weight.like(mean), weight.like(variance)]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 3] {
        let ([input, weight, bias, mean, variance], grad) = back.into_parts();
        let (affine, shape) = (self.affine(&weight, &bias), input.map_shape());
        let statistics = Statistics { mean: mean.slice().to_vec(), variance: variance.slice().to_vec() };
        let [d_input, d_weight, d_bias] =
            super::batch_norm_backward(input.slice(), grad.slice(), &affine, &statistics, &shape);
        [input.like(d_input), weight.like(d_weight), bias.like(d_bias)].map(Some)
    }
}

/// [`batch_norm`]'s result.
#[derive(Debug, Clone)]
pub struct Normalized {
    /// In the shape of the input.
    pub output: Tensor<4>,
    /// Mean of each channel over the batch, without gradient.
    pub mean: Tensor<1>,
    /// Mean square distance of each channel from it, without gradient.
    pub variance: Tensor<1>,
}

impl Normalized {
    /// The running mean and variance after this batch: moved by a tenth, as in PyTorch, towards its mean and its variance without
    /// bias. Without gradient.
    pub fn running(&self, mean: Tensor<1>, variance: Tensor<1>) -> [Tensor<1>; 2] {
        let [batch, _, height, width] = self.output.dims();
        let count = (batch * height * width) as f64;
        let unbiased = self.variance.clone() * (count / (count - 1.0).max(1.0));
        let moved =
            |running: Tensor<1>, found: Tensor<1>| (running * (1.0 - MOMENTUM) + found * MOMENTUM).detach();
        [moved(mean, self.mean.clone()), moved(variance, unbiased)]
    }
}

/// Each channel of `input` (`[batch, channels, height, width]`) less its mean over batch and pixels, over its standard
/// deviation, times `weight` plus `bias` (`[channels]`), then ReLU where asked.
///
/// Panics when there are no pixels or the sizes do not fit each other.
pub fn batch_norm(input: Tensor<4>, weight: Tensor<1>, bias: Tensor<1>, relu: bool) -> Normalized {
    let [_, channels, _, _] = input.dims();
    assert_eq!((weight.dims(), bias.dims()), ([channels], [channels]), "one weight and bias a channel");
    let inputs = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    let [output, mean, variance] = array(outputs(BatchNorm { relu }, inputs));
    Normalized {
        output: Tensor::from_dispatch(output),
        mean: Tensor::from_dispatch(mean),
        variance: Tensor::from_dispatch(variance),
    }
}
