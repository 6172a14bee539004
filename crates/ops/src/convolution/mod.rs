//! Convolutions that end with `activation(sum + bias + residual)`: what dense and depthwise ones share. [`mod@reference`] is
//! the definition of both.

use std::fmt::Debug;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Shape, Tensor};

use crate::Activation;
use crate::activation::activate_tensor;
use crate::conv2d::{self, conv2d_backward_bias};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply, array};

pub mod reference;
#[cfg(test)]
pub(crate) mod tests;

/// Sizes of a 2D convolution. Layouts: input `[batch, in_channels, height, width]`, weight
/// `[out_channels, in_channels / groups, kernel_height, kernel_width]`, output
/// `[batch, out_channels, out_height, out_width]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Conv2dShape {
    /// Images.
    pub batch: usize,
    /// Input channels, of all groups.
    pub in_channels: usize,
    /// Output channels, of all groups.
    pub out_channels: usize,
    /// Parts of the channels that do not see each other: one of a dense convolution, as many as channels of a depthwise one.
    pub groups: usize,
    /// Input height and width.
    pub input: [usize; 2],
    /// Kernel height and width.
    pub kernel: [usize; 2],
    /// Stride down and across.
    pub stride: [usize; 2],
    /// Zeros added above and below, left and right.
    pub padding: [usize; 2],
}

impl Conv2dShape {
    /// Output height and width; 0 where the kernel does not fit.
    pub fn output(&self) -> [usize; 2] {
        [0, 1].map(|i| {
            let padded = self.input[i] + 2 * self.padding[i];
            if padded < self.kernel[i] { 0 } else { (padded - self.kernel[i]) / self.stride[i] + 1 }
        })
    }

    /// Elements of the input.
    pub fn input_len(&self) -> usize {
        self.batch * self.in_channels * self.input[0] * self.input[1]
    }

    /// Elements of the weight.
    pub fn weight_len(&self) -> usize {
        self.weight().iter().product()
    }

    /// Elements of the output.
    pub fn output_len(&self) -> usize {
        let [height, width] = self.output();
        self.batch * self.out_channels * height * width
    }

    pub(crate) fn taps(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    /// The weight's shape.
    fn weight(&self) -> [usize; 4] {
        [self.out_channels, self.in_channels / self.groups, self.kernel[0], self.kernel[1]]
    }

    /// The output's shape.
    fn output_shape(&self) -> [usize; 4] {
        let [height, width] = self.output();
        [self.batch, self.out_channels, height, width]
    }

    /// Panics where the kernels of dense convolutions do not apply.
    pub(crate) fn check_dense(&self) {
        assert_eq!(self.groups, 1, "dense: one group: {self:?}");
    }

    /// Panics where the kernels of depthwise convolutions do not apply.
    pub(crate) fn check_depthwise(&self) {
        let channels = [self.in_channels, self.out_channels];
        assert_eq!(channels, [self.groups; 2], "depthwise: a group for each channel: {self:?}");
        assert_eq!(self.stride, [1, 1], "depthwise: steps of one pixel: {self:?}");
    }

    /// The same in Burn's terms.
    fn options(&self) -> ConvOptions<2> {
        ConvOptions::new(self.stride, self.padding, [1, 1], self.groups)
    }
}

/// A convolution as far as its sums, and its kernels.
pub(crate) trait Convolution: Clone + Debug + Send + 'static {
    fn stride(&self) -> [usize; 2] {
        [1, 1]
    }

    fn padding(&self) -> [usize; 2];

    /// The weight comes as a tensor, for caches that know it again.
    fn forward(
        &self,
        input: &[f32],
        weight: &CpuTensor,
        epilogue: &conv2d::Epilogue,
        shape: &Conv2dShape,
    ) -> Vec<f32>;

    /// Gradient of the input from that of the sums, plus `add`.
    fn backward_input(
        &self,
        weight: &CpuTensor,
        grad: &[f32],
        add: Option<&[f32]>,
        shape: &Conv2dShape,
    ) -> Vec<f32>;

    fn backward_weight(&self, input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32>;

    /// Of this input and weight.
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
            stride: self.stride(),
            padding: self.padding(),
        }
    }
}

/// Of input, weight, bias and, where there is one, residual.
#[derive(Debug, Clone)]
pub(crate) struct Convolved<C> {
    pub(crate) convolution: C,
    pub(crate) activation: Activation,
}

impl<C: Convolution, const N: usize> Operation<N> for Convolved<C> {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.activation)
    }

    fn saved_inputs<T>(inputs: &[T; N]) -> &[T] {
        &inputs[..2]
    }

    fn cpu(&self, inputs: [CpuTensor; N]) -> Vec<CpuTensor> {
        let shape = self.convolution.shape(inputs[0].shape(), inputs[1].shape());
        let bias = Some(inputs[2].slice());
        let residual = inputs.get(3).map(CpuTensor::slice);
        let epilogue = conv2d::Epilogue { bias, residual, activation: self.activation };
        let out = self.convolution.forward(inputs[0].slice(), &inputs[1], &epilogue, &shape);
        vec![CpuTensor::new(out, shape.output_shape())]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor, N>) -> [Option<CpuTensor>; N] {
        let Self { convolution, .. } = self;
        gradients(
            back,
            |[input, weight]| convolution.shape(input.shape(), weight.shape()),
            |[input, weight], grad, add, shape| {
                let add = add.map(CpuTensor::slice);
                input.like(convolution.backward_input(weight, grad.slice(), add, shape))
            },
            |[input, weight], grad, shape| {
                weight.like(convolution.backward_weight(input.slice(), grad.slice(), shape))
            },
            |grad, shape| {
                let pixels = shape.output().iter().product();
                CpuTensor::new(
                    conv2d_backward_bias(grad.slice(), shape.out_channels, pixels),
                    [shape.out_channels],
                )
            },
        )
    }

    fn composed<B: Backend>(&self, inputs: [FloatTensor<B>; N]) -> Vec<FloatTensor<B>> {
        let mut inputs = Vec::from(inputs);
        let residual = inputs.drain(3..).next();
        let [input, weight, bias] = array(inputs);
        let options = self.convolution.shape(input.shape(), weight.shape()).options();
        let sums = B::conv2d(input, weight, Some(bias), options);
        let sums = residual.into_iter().fold(sums, B::float_add);
        vec![activate_tensor::<B>(sums, self.activation)]
    }

    fn composed_backward<B: Backend>(
        &self,
        back: Backprop<FloatTensor<B>, N>,
    ) -> [Option<FloatTensor<B>>; N] {
        gradients(
            back,
            |[input, weight]| self.convolution.shape(input.shape(), weight.shape()),
            |[input, weight], grad, add, shape| {
                let (input, weight) = (input.clone(), weight.clone());
                let d_input = B::conv2d_x_backward(input, weight, grad.clone(), shape.options());
                add.cloned().into_iter().fold(d_input, B::float_add)
            },
            |[input, weight], grad, shape| {
                B::conv2d_weight_backward(input.clone(), weight.clone(), grad.clone(), shape.options())
            },
            |grad, shape| {
                let sums = [0, 2, 3].into_iter().fold(grad.clone(), B::float_sum_dim);
                B::float_reshape(sums, [shape.out_channels].into())
            },
        )
    }
}

/// Of input, weight, bias and residual, from the gradient of the sums. Where the residual is the input as well, its gradient
/// is added to the input's on the way.
fn gradients<T: Clone, const N: usize>(
    back: Backprop<T, N>,
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

/// `[batch, out_channels, out_height, out_width]`. Panics when the kernel does not fit the input or the epilogue the output.
pub(crate) fn convolve(
    convolution: impl Convolution,
    input: Tensor<4>,
    weight: Tensor<4>,
    epilogue: Epilogue,
) -> Tensor<4> {
    let shape = convolution.shape(input.shape(), weight.shape());
    assert!(!shape.output().contains(&0), "the kernel does not fit the input: {shape:?}");
    let Epilogue { bias, residual, activation } = epilogue;
    let bias = bias.unwrap_or_else(|| Tensor::zeros([shape.out_channels], &input.device()));
    assert_eq!(bias.dims(), [shape.out_channels], "a bias for each output channel");
    let operation = Convolved { convolution, activation };
    let operands = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    let Some(residual) = residual else { return apply(operation, operands) };
    assert_eq!(residual.dims(), shape.output_shape(), "a residual for each output element");
    let [input, weight, bias] = operands;
    apply(operation, [input, weight, bias, residual.into_dispatch()])
}
