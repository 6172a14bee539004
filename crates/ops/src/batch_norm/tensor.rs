//! The normalization on tensors: [`batch_norm`] with its gradients.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

use super::{Affine, BatchNormShape, Statistics, composed};
use crate::flex::{Contiguous, sizes, tensor};
use crate::gradients;

/// Share of a batch's statistics in the running ones; PyTorch's default.
const MOMENTUM: f64 = 0.1;

/// The normalization; see [`batch_norm`].
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait BatchNormOps: Backend {
    /// The normalized input, and each channel's mean and variance, which have no gradient.
    fn batch_normalization(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        composed::normalized::<Self>(input, weight, bias, relu)
    }
}

/// What the backward needs of the forward.
#[derive(Debug, Clone)]
pub struct Forward<B: Backend> {
    input: FloatTensor<B>,
    weight: FloatTensor<B>,
    bias: FloatTensor<B>,
    mean: FloatTensor<B>,
    variance: FloatTensor<B>,
    relu: bool,
}

/// Gradients of the normalization.
pub trait BatchNormGradOps: Backend {
    /// Of input, weight and bias.
    fn batch_normalization_grad(forward: Forward<Self>, grad: FloatTensor<Self>) -> [FloatTensor<Self>; 3] {
        let Forward { input, weight, bias, mean, variance, relu } = forward;
        composed::gradients::<Self>([input, weight, bias, mean, variance], relu, grad)
    }
}

#[cfg(feature = "cube")]
impl BatchNormOps for burn_cubecl::CubeBackend {}

#[cfg(feature = "cube")]
impl BatchNormGradOps for burn_cubecl::CubeBackend {}

fn shape_of(input: &impl TensorMetadata) -> BatchNormShape {
    let [batch, channels, height, width] = sizes(input);
    BatchNormShape { batch, channels, pixels: height * width }
}

impl BatchNormOps for Flex {
    fn batch_normalization(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let (shape, size) = (shape_of(&input), input.shape());
        let [input, weight, bias] = [&input, &weight, &bias].map(Contiguous::new);
        let affine = Affine { weight: weight.slice(), bias: bias.slice(), relu };
        let (out, Statistics { mean, variance }) = super::batch_norm(input.slice(), &affine, &shape);
        (tensor(out, size), tensor(mean, [shape.channels]), tensor(variance, [shape.channels]))
    }
}

impl BatchNormGradOps for Flex {
    fn batch_normalization_grad(forward: Forward<Self>, grad: FloatTensor<Self>) -> [FloatTensor<Self>; 3] {
        let (shape, size) = (shape_of(&forward.input), forward.input.shape());
        let Forward { input, weight, bias, mean, variance, relu } = forward;
        let [input, weight, bias, grad] = [&input, &weight, &bias, &grad].map(Contiguous::new);
        let [mean, variance] = [&mean, &variance].map(|values| Contiguous::new(values).slice().to_vec());
        let affine = Affine { weight: weight.slice(), bias: bias.slice(), relu };
        let statistics = Statistics { mean, variance };
        let gradients = super::batch_norm_backward(input.slice(), grad.slice(), &affine, &statistics, &shape);
        let per_channel = |values| tensor(values, [shape.channels]);
        [tensor(gradients.input, size), per_channel(gradients.weight), per_channel(gradients.bias)]
    }
}

#[derive(Debug)]
struct BatchNormBackward;

impl<B: BatchNormGradOps> Backward<B, 3> for BatchNormBackward {
    type State = Forward<B>;

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        gradients::register::<B, _, 3>(ops, grads, B::batch_normalization_grad);
    }
}

impl<B: BatchNormOps + BatchNormGradOps, C: CheckpointStrategy> BatchNormOps for Autodiff<B, C> {
    fn batch_normalization(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let guards = [input.node(), weight.node(), bias.node()];
        let [input, weight, bias] = [input, weight, bias].map(|tensor| tensor.into_primitive());
        let (out, mean, variance) = B::batch_normalization(input.clone(), weight.clone(), bias.clone(), relu);
        let statistics =
            [&mean, &variance].map(|values| <Self as AutodiffBackend>::from_inner(values.clone()));
        let out = match BatchNormBackward.prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(Forward { input, weight, bias, mean, variance, relu }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        };
        let [mean, variance] = statistics;
        (out, mean, variance)
    }
}

/// [`batch_norm`]'s result.
#[derive(Debug, Clone)]
pub struct Normalized {
    /// Of the input's shape.
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
    let (output, mean, variance) = Dispatch::batch_normalization(
        input.into_dispatch(),
        weight.into_dispatch(),
        bias.into_dispatch(),
        relu,
    );
    Normalized {
        output: Tensor::from_dispatch(output),
        mean: Tensor::from_dispatch(mean),
        variance: Tensor::from_dispatch(variance),
    }
}
