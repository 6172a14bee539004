//! Convolutions that end with `activation(sum + bias + residual)`, dense and depthwise, as one operation. [`mod@reference`] is
//! the definition.

#[cfg(feature = "cube")]
use burn::backend::ops::{FloatTensorOps as _, ModuleOps as _};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::{Shape, Tensor};
#[cfg(feature = "cube")]
use burn_cubecl::{CubeBackend, tensor::CubeTensor};
use srflow_simd::Isa;

use crate::Activation;
use crate::activation::activate_tensor;
use crate::conv2d::{self, conv2d_backward_bias, conv2d_backward_weight, tensor::Conv2dOptions};
use crate::depthwise::{self, depthwise_backward_weight};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Composition, Operation, apply, array};
use crate::precision::cpu_precision;
use crate::weight_cache::Pass;
#[cfg(feature = "cube")]
use crate::{
    conv2d::possible,
    precision::{Precision, precision},
};

#[cfg(feature = "cube")]
mod cube;
pub mod reference;
mod shape;
#[cfg(test)]
pub(crate) mod tests;

pub use shape::Conv2dShape;

/// Which kernels compute a convolution on the CPU.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Kernels {
    Dense,
    Depthwise,
}

/// Of input, weight, bias and, where there is one, residual.
#[derive(Debug, Clone)]
pub(crate) struct Convolution {
    pub(crate) kernels: Kernels,
    pub(crate) options: Conv2dOptions,
    pub(crate) activation: Activation,
}

impl Convolution {
    fn shape(&self, input: Shape, weight: Shape) -> Conv2dShape {
        let [batch, in_channels, height, width] = input.dims();
        let [out_channels, inputs, kernel_height, kernel_width] = weight.dims();
        Conv2dShape {
            batch,
            in_channels,
            out_channels,
            groups: in_channels / inputs,
            input: [height, width],
            kernel: [kernel_height, kernel_width],
            stride: self.options.stride,
            padding: self.options.padding,
        }
    }
}

#[cfg(feature = "cube")]
impl Convolution {
    /// Whether another device than the CPU multiplies numbers of 16 bits.
    fn in_16_bits(&self, shape: &Conv2dShape) -> bool {
        let wanted = possible(precision(), [shape.in_channels, shape.out_channels]);
        matches!(self.kernels, Kernels::Dense) && wanted != Precision::F32
    }
}

impl<const N: usize> Composition<N> for Convolution {
    fn composed<B: Backend>(&self, inputs: [FloatTensor<B>; N]) -> Vec<FloatTensor<B>> {
        let mut inputs = Vec::from(inputs);
        let residual = inputs.drain(3..).next();
        let [input, weight, bias] = array(inputs);
        let options = self.shape(input.shape(), weight.shape()).options();
        let sums = B::conv2d(input, weight, Some(bias), options);
        let sums = residual.into_iter().fold(sums, B::float_add);
        vec![activate_tensor::<B>(sums, self.activation)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; N] {
        gradients(
            back,
            |[input, weight]| self.shape(input.shape(), weight.shape()),
            |[input, weight], grad, add, shape| {
                let (input, weight) = (input.clone(), weight.clone());
                let d_input = B::conv2d_x_backward(input, weight, grad.clone(), shape.options());
                plus::<B>(d_input, add)
            },
            |[input, weight], grad, shape| {
                B::conv2d_weight_backward(input.clone(), weight.clone(), grad.clone(), shape.options())
            },
            bias_gradient::<B>,
        )
    }
}

fn plus<B: Backend>(sum: FloatTensor<B>, more: Option<&FloatTensor<B>>) -> FloatTensor<B> {
    more.cloned().into_iter().fold(sum, B::float_add)
}

fn bias_gradient<B: Backend>(grad: &FloatTensor<B>, shape: &Conv2dShape) -> FloatTensor<B> {
    let sums = [0, 2, 3].into_iter().fold(grad.clone(), B::float_sum_dim);
    B::float_reshape(sums, [shape.out_channels].into())
}

impl<const N: usize> Operation<N> for Convolution {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.activation)
    }

    fn saved_inputs<T>(inputs: &[T; N]) -> &[T] {
        &inputs[..2]
    }

    fn cpu(&self, inputs: [CpuTensor; N]) -> Vec<CpuTensor> {
        let [input, weight] = [&inputs[0], &inputs[1]];
        let shape = self.shape(input.shape(), weight.shape());
        let bias = Some(inputs[2].slice());
        let residual = inputs.get(3).map(CpuTensor::slice);
        let epilogue = conv2d::Epilogue { bias, residual, activation: self.activation };
        let out = match self.kernels {
            Kernels::Dense => {
                let packed = self.options.packed(Pass::Forward, weight, &shape);
                conv2d::convolve_packed(Isa::best(), input.slice(), &packed, &epilogue, &shape)
            }
            Kernels::Depthwise => depthwise::depthwise(input.slice(), weight.slice(), &epilogue, &shape),
        };
        vec![CpuTensor::new(out, shape.output_shape())]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; N] {
        gradients(
            back,
            |[input, weight]| self.shape(input.shape(), weight.shape()),
            |[input, weight], grad, add, shape| {
                let (isa, grad, add) = (Isa::best(), grad.slice(), add.map(CpuTensor::slice));
                let epilogue = conv2d::Epilogue { residual: add, ..conv2d::Epilogue::default() };
                input.like(match self.kernels {
                    Kernels::Dense => {
                        let packed = self.options.packed(Pass::Backward, weight, shape);
                        conv2d::backward_input_packed(isa, grad, &packed, &epilogue, shape)
                    }
                    Kernels::Depthwise => depthwise::backward_input_with(
                        isa,
                        cpu_precision(),
                        [grad, weight.slice()],
                        add,
                        shape,
                    ),
                })
            },
            |[input, weight], grad, shape| {
                weight.like(match self.kernels {
                    Kernels::Dense => conv2d_backward_weight(input.slice(), grad.slice(), shape),
                    Kernels::Depthwise => depthwise_backward_weight(input.slice(), grad.slice(), shape),
                })
            },
            |grad, shape| {
                let (channels, pixels) = (shape.out_channels, shape.output().iter().product());
                CpuTensor::new(conv2d_backward_bias(grad.slice(), channels, pixels), [channels])
            },
        )
    }

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; N]) -> Vec<CubeTensor> {
        let shape = self.shape(inputs[0].shape(), inputs[1].shape());
        if !self.in_16_bits(&shape) {
            return self.composed::<CubeBackend>(inputs);
        }
        let mut inputs = Vec::from(inputs);
        let residual = inputs.drain(3..).next();
        let [input, weight, bias] = array(inputs);
        let bias = CubeBackend::float_reshape(bias, [1, shape.out_channels, 1, 1].into());
        let sums = CubeBackend::float_add(cube::sums(input, weight, &shape), bias);
        vec![activate_tensor::<CubeBackend>(plus::<CubeBackend>(sums, residual.as_ref()), self.activation)]
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; N] {
        gradients(
            back,
            |[input, weight]| self.shape(input.shape(), weight.shape()),
            |[input, weight], grad, add, shape| {
                let d_input = match self.kernels {
                    Kernels::Depthwise if shape.stride == [1, 1] => {
                        Some(depthwise::cube::backward_input(grad, weight, shape))
                    }
                    _ if self.in_16_bits(shape) => cube::backward_input(grad, weight, shape),
                    _ => None,
                };
                let d_input = d_input.unwrap_or_else(|| {
                    let (input, weight) = (input.clone(), weight.clone());
                    CubeBackend::conv2d_x_backward(input, weight, grad.clone(), shape.options())
                });
                plus::<CubeBackend>(d_input, add)
            },
            |[input, weight], grad, shape| match self.kernels {
                Kernels::Depthwise if shape.stride == [1, 1] => {
                    depthwise::cube::backward_weight(input, grad, shape)
                }
                _ if self.in_16_bits(shape) => cube::backward_weight(input, grad, shape),
                _ => {
                    let (input, weight) = (input.clone(), weight.clone());
                    CubeBackend::conv2d_weight_backward(input, weight, grad.clone(), shape.options())
                }
            },
            bias_gradient::<CubeBackend>,
        )
    }
}

/// Of input, weight, bias and residual, from the gradient of the sums. Where the residual is the input as well, its gradient
/// is added to the input's on the way.
fn gradients<T: Clone, const N: usize>(
    back: Backprop<T>,
    shape: impl Fn(&[T; 2]) -> Conv2dShape,
    of_input: impl Fn(&[T; 2], &T, Option<&T>, &Conv2dShape) -> T,
    of_weight: impl Fn(&[T; 2], &T, &Conv2dShape) -> T,
    of_bias: impl Fn(&T, &Conv2dShape) -> T,
) -> [Option<T>; N] {
    let residual_is_input = back.are_one(0, 3);
    let wanted: [bool; N] = std::array::from_fn(|input| back.wants(input));
    let (operands, grad) = back.into_parts();
    let shape = shape(&operands);
    std::array::from_fn(|input| match input {
        _ if !wanted[input] => None,
        0 => Some(of_input(&operands, &grad, residual_is_input.then_some(&grad), &shape)),
        1 => Some(of_weight(&operands, &grad, &shape)),
        2 => Some(of_bias(&grad, &shape)),
        _ => (!residual_is_input).then(|| grad.clone()),
    })
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
}

/// The output, `[batch, out_channels, out_height, out_width]`. Panics when the kernel does not fit the input, or the epilogue the
/// output.
pub(crate) fn convolve(
    kernels: Kernels,
    input: Tensor<4>,
    weight: Tensor<4>,
    epilogue: Epilogue,
    options: Conv2dOptions,
) -> Tensor<4> {
    let Epilogue { bias, residual, activation } = epilogue;
    let convolution = Convolution { kernels, options, activation };
    let shape = convolution.shape(input.shape(), weight.shape());
    assert!(!shape.output().contains(&0), "the kernel does not fit the input: {shape:?}");
    let bias = bias.unwrap_or_else(|| Tensor::zeros([shape.out_channels], &input.device()));
    assert_eq!(bias.dims(), [shape.out_channels], "a bias for each output channel");
    let operands = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    let Some(residual) = residual else { return apply(convolution, operands) };
    assert_eq!(residual.dims(), shape.output_shape(), "a residual for each output element");
    let [input, weight, bias] = operands;
    apply(convolution, [input, weight, bias, residual.into_dispatch()])
}
