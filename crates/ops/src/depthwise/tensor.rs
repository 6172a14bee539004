//! The depthwise convolution on tensors: [`depthwise`] with gradients.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Shape, Tensor};
use srflow_simd::Isa;

use super::DepthwiseShape;
use super::backward::backward_input_with;
use crate::Activation;
use crate::activation::activate_tensor;
use crate::conv2d;
use crate::conv2d::tensor::Epilogue;
use crate::flex::{Contiguous, tensor};
use crate::tracked::{Convolution, EpilogueGradOps, tracked};

/// Depthwise convolution with its epilogue. The default is Burn's own convolution.
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait DepthwiseOps: Backend {
    /// `activation(depthwise(input, weight) + bias)`.
    fn biased_depthwise(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        padding: [usize; 2],
        activation: Activation,
    ) -> FloatTensor<Self> {
        let grouped = grouped(&input.shape(), padding);
        let out = Self::conv2d(input, weight, Some(bias), grouped);
        activate_tensor::<Self>(out, activation)
    }

    /// `activation(depthwise(input, weight) + bias + residual)`.
    fn residual_depthwise(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        padding: [usize; 2],
        activation: Activation,
    ) -> FloatTensor<Self> {
        let grouped = grouped(&input.shape(), padding);
        let out = Self::conv2d(input, weight, Some(bias), grouped);
        activate_tensor::<Self>(Self::float_add(out, residual), activation)
    }
}

/// Gradients of a depthwise convolution without epilogue. The defaults are Burn's own.
pub trait DepthwiseGradOps: Backend {
    /// Gradient of the input, plus `add`.
    fn depthwise_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        add: Option<FloatTensor<Self>>,
        padding: [usize; 2],
    ) -> FloatTensor<Self> {
        let grouped = grouped(&input.shape(), padding);
        let d_input = Self::conv2d_x_backward(input, weight, grad, grouped);
        match add {
            None => d_input,
            Some(add) => Self::float_add(d_input, add),
        }
    }

    /// Gradient of the weight.
    fn depthwise_weight_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        padding: [usize; 2],
    ) -> FloatTensor<Self> {
        let grouped = grouped(&input.shape(), padding);
        Self::conv2d_weight_backward(input, weight, grad, grouped)
    }
}

#[cfg(feature = "cube")]
impl DepthwiseOps for burn_cubecl::CubeBackend {}

#[cfg(feature = "cube")]
impl DepthwiseGradOps for burn_cubecl::CubeBackend {}

fn shape_of(input: &Shape, weight: &Shape, padding: [usize; 2]) -> DepthwiseShape {
    let [batch, channels, height, width] = input.dims();
    let [_, _, kernel_height, kernel_width] = weight.dims();
    DepthwiseShape { batch, channels, input: [height, width], kernel: [kernel_height, kernel_width], padding }
}

/// The same to Burn: as many groups as channels.
fn grouped(input: &Shape, padding: [usize; 2]) -> ConvOptions<2> {
    ConvOptions::new([1, 1], padding, [1, 1], input.dims::<4>()[1])
}

fn convolve(
    input: &FloatTensor<Flex>,
    weight: &FloatTensor<Flex>,
    epilogue: &conv2d::Epilogue,
    padding: [usize; 2],
) -> FloatTensor<Flex> {
    let shape = shape_of(&input.shape(), &weight.shape(), padding);
    let (input, weight) = (Contiguous::new(input), Contiguous::new(weight));
    let out = super::depthwise(input.slice(), weight.slice(), epilogue, &shape);
    let [height, width] = shape.output();
    tensor(out, [shape.batch, shape.channels, height, width])
}

impl DepthwiseOps for Flex {
    fn biased_depthwise(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        padding: [usize; 2],
        activation: Activation,
    ) -> FloatTensor<Self> {
        let bias = Contiguous::new(&bias);
        let epilogue = conv2d::Epilogue { bias: Some(bias.slice()), residual: None, activation };
        convolve(&input, &weight, &epilogue, padding)
    }

    fn residual_depthwise(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        padding: [usize; 2],
        activation: Activation,
    ) -> FloatTensor<Self> {
        let (bias, residual) = (Contiguous::new(&bias), Contiguous::new(&residual));
        let epilogue =
            conv2d::Epilogue { bias: Some(bias.slice()), residual: Some(residual.slice()), activation };
        convolve(&input, &weight, &epilogue, padding)
    }
}

impl DepthwiseGradOps for Flex {
    fn depthwise_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        add: Option<FloatTensor<Self>>,
        padding: [usize; 2],
    ) -> FloatTensor<Self> {
        let shape = shape_of(&input.shape(), &weight.shape(), padding);
        let (weight, grad, add) =
            (Contiguous::new(&weight), Contiguous::new(&grad), add.as_ref().map(Contiguous::new));
        let add = add.as_ref().map(Contiguous::slice);
        let d_input = backward_input_with(Isa::best(), grad.slice(), weight.slice(), add, &shape);
        tensor(d_input, input.shape())
    }

    fn depthwise_weight_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        padding: [usize; 2],
    ) -> FloatTensor<Self> {
        let shape = shape_of(&input.shape(), &weight.shape(), padding);
        let (input, grad) = (Contiguous::new(&input), Contiguous::new(&grad));
        tensor(super::depthwise_backward_weight(input.slice(), grad.slice(), &shape), weight.shape())
    }
}

/// A depthwise convolution by its padding.
#[derive(Debug, Clone)]
struct Depthwise([usize; 2]);

impl<B: DepthwiseOps + DepthwiseGradOps> Convolution<B> for Depthwise {
    fn forward(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        bias: FloatTensor<B>,
        residual: Option<FloatTensor<B>>,
        activation: Activation,
    ) -> FloatTensor<B> {
        match residual {
            None => B::biased_depthwise(input, weight, bias, self.0, activation),
            Some(residual) => B::residual_depthwise(input, weight, bias, residual, self.0, activation),
        }
    }

    fn input_grad(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        grad: FloatTensor<B>,
        add: Option<FloatTensor<B>>,
    ) -> FloatTensor<B> {
        B::depthwise_input_grad(input, weight, grad, add, self.0)
    }

    fn weight_grad(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        grad: FloatTensor<B>,
    ) -> FloatTensor<B> {
        B::depthwise_weight_grad(input, weight, grad, self.0)
    }
}

impl<B, C> DepthwiseOps for Autodiff<B, C>
where
    B: DepthwiseOps + DepthwiseGradOps + EpilogueGradOps,
    C: CheckpointStrategy,
{
    fn biased_depthwise(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        padding: [usize; 2],
        activation: Activation,
    ) -> FloatTensor<Self> {
        tracked::<B, C>(Depthwise(padding), [input, weight, bias], None, activation)
    }

    fn residual_depthwise(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        padding: [usize; 2],
        activation: Activation,
    ) -> FloatTensor<Self> {
        tracked::<B, C>(Depthwise(padding), [input, weight, bias], Some(residual), activation)
    }
}

/// Depthwise convolution of `input` (`[batch, channels, height, width]`) with `weight`
/// (`[channels, 1, kernel_height, kernel_width]`), with stride 1 and `padding` zeros above and below, left and right.
///
/// Panics when the sizes do not fit each other or the padding is not smaller than the kernel.
pub fn depthwise(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, padding: [usize; 2]) -> Tensor<4> {
    let shape = shape_of(&input.shape(), &weight.shape(), padding);
    assert_eq!(weight.dims()[..2], [shape.channels, 1], "depthwise: a kernel for each channel");
    let smaller = shape.padding.iter().zip(shape.kernel).all(|(&padding, kernel)| padding < kernel);
    assert!(smaller, "depthwise: padding smaller than the kernel: {shape:?}");
    let [height, width] = shape.output();
    assert!(height > 0 && width > 0, "depthwise: the kernel does not fit the input: {shape:?}");
    let activation = epilogue.activation;
    let (bias, residual) = epilogue.checked([shape.batch, shape.channels, height, width], &input.device());
    let (input, weight) = (input.into_dispatch(), weight.into_dispatch());
    Tensor::from_dispatch(match residual {
        None => Dispatch::biased_depthwise(input, weight, bias, padding, activation),
        Some(residual) => Dispatch::residual_depthwise(input, weight, bias, residual, padding, activation),
    })
}
