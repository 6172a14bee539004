//! The convolution on tensors: [`conv2d`] with gradients.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, DispatchTensor, Flex, TensorMetadata, backend_extension};
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, Shape, Tensor};

use super::forward::{convolve_packed, pack};
use super::{Conv2dShape, Epilogue};
use crate::activation::activate_tensor;
use crate::flex::{Contiguous, sizes, tensor};
use crate::simd::Isa;
use crate::{Activation, WeightCache};

/// How a kernel moves over its input.
#[derive(Debug, Clone)]
pub struct Conv2dOptions {
    /// Stride down and across.
    pub stride: [usize; 2],
    /// Zeros added above and below, left and right.
    pub padding: [usize; 2],
    /// Of the weight.
    pub cache: WeightCache,
}

impl Conv2dOptions {
    /// With a cache that no other call shares.
    pub fn new(stride: [usize; 2], padding: [usize; 2]) -> Self {
        Self { stride, padding, cache: WeightCache::default() }
    }
}

impl From<Conv2dOptions> for ConvOptions<2> {
    fn from(options: Conv2dOptions) -> Self {
        ConvOptions::new(options.stride, options.padding, [1, 1], 1)
    }
}

/// Dense convolution with its epilogue. The default is Burn's own convolution.
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait Conv2dOps: Backend {
    /// `activation(conv(input, weight) + bias)`.
    fn biased_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let out = Self::conv2d(input, weight, Some(bias), options.into());
        activate_tensor::<Self>(out, activation)
    }

    /// `activation(conv(input, weight) + bias + residual)`.
    fn residual_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let out = Self::conv2d(input, weight, Some(bias), options.into());
        activate_tensor::<Self>(Self::float_add(out, residual), activation)
    }
}

/// Gradients of a convolution with its bias. The defaults are Burn's own.
pub trait Conv2dGradOps: Backend {
    /// Gradient of the input.
    fn conv2d_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        options: Conv2dOptions,
    ) -> FloatTensor<Self> {
        Self::conv2d_x_backward(input, weight, grad, options.into())
    }

    /// Gradient of the weight.
    fn conv2d_weight_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        options: Conv2dOptions,
    ) -> FloatTensor<Self> {
        Self::conv2d_weight_backward(input, weight, grad, options.into())
    }

    /// Gradient of the bias, `[out_channels]`.
    fn conv2d_bias_grad(grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let [_, channels, _, _] = sizes(&grad);
        let sum = [0, 2, 3].into_iter().fold(grad, Self::float_sum_dim);
        Self::float_reshape(sum, [channels].into())
    }
}

#[cfg(feature = "cube")]
impl Conv2dOps for burn_cubecl::CubeBackend {}

#[cfg(feature = "cube")]
impl Conv2dGradOps for burn_cubecl::CubeBackend {}

fn shape_of(input: &Shape, weight: &Shape, options: &Conv2dOptions) -> Conv2dShape {
    let [batch, in_channels, height, width] = input.dims();
    let [out_channels, _, kernel_height, kernel_width] = weight.dims();
    Conv2dShape {
        batch,
        in_channels,
        out_channels,
        input: [height, width],
        kernel: [kernel_height, kernel_width],
        stride: options.stride,
        padding: options.padding,
    }
}

fn convolve(
    input: &FloatTensor<Flex>,
    weight: &FloatTensor<Flex>,
    epilogue: &Epilogue,
    options: Conv2dOptions,
) -> FloatTensor<Flex> {
    let shape = shape_of(&input.shape(), &weight.shape(), &options);
    let isa = Isa::best();
    let packed = options.cache.get(weight, |weight| pack(isa, weight, &shape));
    let out = convolve_packed(isa, Contiguous::new(input).slice(), &packed, epilogue, &shape);
    let [height, width] = shape.output();
    tensor(out, [shape.batch, shape.out_channels, height, width])
}

impl Conv2dOps for Flex {
    fn biased_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let bias = Contiguous::new(&bias);
        let epilogue = Epilogue { bias: Some(bias.slice()), residual: None, activation };
        convolve(&input, &weight, &epilogue, options)
    }

    fn residual_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let (bias, residual) = (Contiguous::new(&bias), Contiguous::new(&residual));
        let epilogue = Epilogue { bias: Some(bias.slice()), residual: Some(residual.slice()), activation };
        convolve(&input, &weight, &epilogue, options)
    }
}

impl Conv2dGradOps for Flex {
    fn conv2d_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        options: Conv2dOptions,
    ) -> FloatTensor<Self> {
        let shape = shape_of(&input.shape(), &weight.shape(), &options);
        let (weight, grad) = (Contiguous::new(&weight), Contiguous::new(&grad));
        tensor(super::conv2d_backward_input(grad.slice(), weight.slice(), &shape), input.shape())
    }

    fn conv2d_weight_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        options: Conv2dOptions,
    ) -> FloatTensor<Self> {
        let shape = shape_of(&input.shape(), &weight.shape(), &options);
        let (input, grad) = (Contiguous::new(&input), Contiguous::new(&grad));
        tensor(super::conv2d_backward_weight(input.slice(), grad.slice(), &shape), weight.shape())
    }

    fn conv2d_bias_grad(grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let [_, channels, height, width] = sizes(&grad);
        let grad = Contiguous::new(&grad);
        tensor(super::conv2d_backward_bias(grad.slice(), channels, height * width), [channels])
    }
}

/// Backward of the convolution with its bias; what else the epilogue adds and applies are operations of their own here,
/// so that each has its gradient.
#[derive(Debug)]
struct Conv2dBackward;

impl<B: Conv2dGradOps> Backward<B, 3> for Conv2dBackward {
    type State = (FloatTensor<B>, FloatTensor<B>, Conv2dOptions);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let (input, weight, options) = ops.state;
        let [input_node, weight_node, bias_node] = ops.parents;
        if let Some(node) = input_node {
            let d_input = B::conv2d_input_grad(input.clone(), weight.clone(), grad.clone(), options.clone());
            grads.register::<B>(node.id, d_input);
        }
        if let Some(node) = weight_node {
            let d_weight = B::conv2d_weight_grad(input, weight, grad.clone(), options);
            grads.register::<B>(node.id, d_weight);
        }
        if let Some(node) = bias_node {
            grads.register::<B>(node.id, B::conv2d_bias_grad(grad));
        }
    }
}

fn tracked_conv2d<B: Conv2dOps + Conv2dGradOps, C: CheckpointStrategy>(
    input: FloatTensor<Autodiff<B, C>>,
    weight: FloatTensor<Autodiff<B, C>>,
    bias: FloatTensor<Autodiff<B, C>>,
    options: Conv2dOptions,
) -> FloatTensor<Autodiff<B, C>> {
    let guards = [input.node(), weight.node(), bias.node()];
    let [input, weight, bias] = [input, weight, bias].map(|tensor| tensor.into_primitive());
    let out = B::biased_conv2d(input.clone(), weight.clone(), bias, options.clone(), Activation::Identity);
    match Conv2dBackward.prepare::<C>(guards).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish((input, weight, options), out),
        OpsKind::UnTracked(prep) => prep.finish(out),
    }
}

impl<B: Conv2dOps + Conv2dGradOps, C: CheckpointStrategy> Conv2dOps for Autodiff<B, C> {
    fn biased_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        activate_tensor::<Self>(tracked_conv2d::<B, C>(input, weight, bias, options), activation)
    }

    fn residual_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let out = tracked_conv2d::<B, C>(input, weight, bias, options);
        activate_tensor::<Self>(Self::float_add(out, residual), activation)
    }
}

/// What becomes of a convolution's sums: `activation(sum + bias + residual)`.
#[derive(Debug, Clone, Default)]
pub struct Finish {
    /// One number per output channel, `[out_channels]`.
    pub bias: Option<Tensor<1>>,
    /// One number per output element, of the output's shape.
    pub residual: Option<Tensor<4>>,
    /// Applied last.
    pub activation: Activation,
}

impl Finish {
    /// Only an activation.
    pub fn with(activation: Activation) -> Self {
        Self { activation, ..Self::default() }
    }

    /// With a bias.
    pub fn bias(self, bias: Option<Tensor<1>>) -> Self {
        Self { bias, ..self }
    }

    /// With something of the output's shape added.
    pub fn residual(self, residual: Tensor<4>) -> Self {
        Self { residual: Some(residual), ..self }
    }

    /// The bias, zeros where there is none, and the residual; both checked.
    pub(crate) fn checked(
        self,
        output: [usize; 4],
        device: &Device,
    ) -> (DispatchTensor, Option<DispatchTensor>) {
        let bias = self.bias.unwrap_or_else(|| Tensor::zeros([output[1]], device));
        assert_eq!(bias.dims(), [output[1]], "a bias for each output channel");
        if let Some(residual) = &self.residual {
            assert_eq!(residual.dims(), output, "a residual for each output element");
        }
        (bias.into_dispatch(), self.residual.map(Tensor::into_dispatch))
    }
}

/// Convolution of `input` (`[batch, in_channels, height, width]`) with `weight`
/// (`[out_channels, in_channels, kernel_height, kernel_width]`): `[batch, out_channels, out_height, out_width]`.
///
/// Panics when the sizes do not fit each other.
pub fn conv2d(input: Tensor<4>, weight: Tensor<4>, finish: Finish, options: Conv2dOptions) -> Tensor<4> {
    let shape = shape_of(&input.shape(), &weight.shape(), &options);
    assert_eq!(weight.dims()[1], shape.in_channels, "conv2d: channels of the weight and of the input");
    let [height, width] = shape.output();
    assert!(height > 0 && width > 0, "conv2d: the kernel does not fit the input: {shape:?}");
    let activation = finish.activation;
    let (bias, residual) = finish.checked([shape.batch, shape.out_channels, height, width], &input.device());
    let (input, weight) = (input.into_dispatch(), weight.into_dispatch());
    Tensor::from_dispatch(match residual {
        None => Dispatch::biased_conv2d(input, weight, bias, options, activation),
        Some(residual) => Dispatch::residual_conv2d(input, weight, bias, residual, options, activation),
    })
}
