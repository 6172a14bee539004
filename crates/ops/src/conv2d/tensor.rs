//! The convolution on tensors: [`conv2d`] with gradients.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, DispatchTensor, Flex, TensorMetadata, backend_extension};
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, Shape, Tensor};
use srflow_simd::Isa;

use super::Conv2dShape;
use super::backward::{backward_input_packed, pack_backward};
use super::forward::{convolve_packed, pack};
use crate::activation::activate_tensor;
use crate::flex::{Contiguous, tensor};
use crate::tracked::{Convolution, EpilogueGradOps, tracked};
use crate::weight_cache::{Packing, Pass};
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

    fn packing(&self, pass: Pass, isa: Isa) -> Packing {
        Packing { pass, isa, stride: self.stride, padding: self.padding }
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

/// Gradients of a convolution without epilogue. The defaults are Burn's own.
pub trait Conv2dGradOps: Backend {
    /// Gradient of the input, plus `add`.
    fn conv2d_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        add: Option<FloatTensor<Self>>,
        options: Conv2dOptions,
    ) -> FloatTensor<Self> {
        let d_input = Self::conv2d_x_backward(input, weight, grad, options.into());
        match add {
            None => d_input,
            Some(add) => Self::float_add(d_input, add),
        }
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
    epilogue: &super::Epilogue,
    options: Conv2dOptions,
) -> FloatTensor<Flex> {
    let shape = shape_of(&input.shape(), &weight.shape(), &options);
    let isa = Isa::best();
    let packed =
        options.cache.get(options.packing(Pass::Forward, isa), weight, |weight| pack(isa, weight, &shape));
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
        let epilogue = super::Epilogue { bias: Some(bias.slice()), residual: None, activation };
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
        let epilogue =
            super::Epilogue { bias: Some(bias.slice()), residual: Some(residual.slice()), activation };
        convolve(&input, &weight, &epilogue, options)
    }
}

impl Conv2dGradOps for Flex {
    fn conv2d_input_grad(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        add: Option<FloatTensor<Self>>,
        options: Conv2dOptions,
    ) -> FloatTensor<Self> {
        let shape = shape_of(&input.shape(), &weight.shape(), &options);
        let isa = Isa::best();
        let packed = options
            .cache
            .get(options.packing(Pass::Backward, isa), &weight, |weight| pack_backward(isa, weight, &shape));
        let (grad, add) = (Contiguous::new(&grad), add.as_ref().map(Contiguous::new));
        let add = add.as_ref().map(Contiguous::slice);
        tensor(backward_input_packed(isa, grad.slice(), &packed, add, &shape), input.shape())
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
}

impl<B: Conv2dOps + Conv2dGradOps> Convolution<B> for Conv2dOptions {
    fn forward(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        bias: FloatTensor<B>,
        residual: Option<FloatTensor<B>>,
        activation: Activation,
    ) -> FloatTensor<B> {
        match residual {
            None => B::biased_conv2d(input, weight, bias, self, activation),
            Some(residual) => B::residual_conv2d(input, weight, bias, residual, self, activation),
        }
    }

    fn input_grad(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        grad: FloatTensor<B>,
        add: Option<FloatTensor<B>>,
    ) -> FloatTensor<B> {
        B::conv2d_input_grad(input, weight, grad, add, self)
    }

    fn weight_grad(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        grad: FloatTensor<B>,
    ) -> FloatTensor<B> {
        B::conv2d_weight_grad(input, weight, grad, self)
    }
}

impl<B, C> Conv2dOps for Autodiff<B, C>
where
    B: Conv2dOps + Conv2dGradOps + EpilogueGradOps,
    C: CheckpointStrategy,
{
    fn biased_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        tracked::<B, C>(options, [input, weight, bias], None, activation)
    }

    fn residual_conv2d(
        input: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        bias: FloatTensor<Self>,
        residual: FloatTensor<Self>,
        options: Conv2dOptions,
        activation: Activation,
    ) -> FloatTensor<Self> {
        tracked::<B, C>(options, [input, weight, bias], Some(residual), activation)
    }
}

/// What becomes of a convolution's sums: `activation(sum + bias + residual)`.
#[derive(Debug, Clone, Default)]
pub struct Epilogue {
    /// One number per output channel, `[out_channels]`.
    pub bias: Option<Tensor<1>>,
    /// One number per output element, of the output's shape.
    pub residual: Option<Tensor<4>>,
    /// Applied last.
    pub activation: Activation,
}

impl Epilogue {
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
pub fn conv2d(input: Tensor<4>, weight: Tensor<4>, epilogue: Epilogue, options: Conv2dOptions) -> Tensor<4> {
    let shape = shape_of(&input.shape(), &weight.shape(), &options);
    assert_eq!(weight.dims()[1], shape.in_channels, "conv2d: channels of the weight and of the input");
    let [height, width] = shape.output();
    assert!(height > 0 && width > 0, "conv2d: the kernel does not fit the input: {shape:?}");
    let activation = epilogue.activation;
    let (bias, residual) =
        epilogue.checked([shape.batch, shape.out_channels, height, width], &input.device());
    let (input, weight) = (input.into_dispatch(), weight.into_dispatch());
    Tensor::from_dispatch(match residual {
        None => Dispatch::biased_conv2d(input, weight, bias, options, activation),
        Some(residual) => Dispatch::residual_conv2d(input, weight, bias, residual, options, activation),
    })
}
