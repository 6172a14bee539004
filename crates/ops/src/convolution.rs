//! Convolutions that end with `activation(sum + bias + residual)` as operations: what dense and depthwise ones share.

use std::fmt::Debug;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::Tensor;
use burn::tensor::ops::ConvOptions;

use crate::Activation;
use crate::activation::activate_tensor;
use crate::conv2d::{self, conv2d_backward_bias};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply, array};

/// A convolution as far as its sums.
pub(crate) trait Convolution: Clone + Debug + Send + 'static {
    /// The same in Burn's terms, of so many input channels.
    fn options(&self, channels: usize) -> ConvOptions<2>;

    fn cpu(&self, input: &CpuTensor, weight: &CpuTensor, epilogue: &conv2d::Epilogue) -> CpuTensor;

    /// Gradient of the input from that of the sums, plus `add`.
    fn cpu_backward_input(
        &self,
        operands: &[CpuTensor; 2],
        grad: &CpuTensor,
        add: Option<&CpuTensor>,
    ) -> CpuTensor;

    fn cpu_backward_weight(&self, operands: &[CpuTensor; 2], grad: &CpuTensor) -> CpuTensor;
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
        let bias = Some(inputs[2].slice());
        let residual = inputs.get(3).map(CpuTensor::slice);
        let epilogue = conv2d::Epilogue { bias, residual, activation: self.activation };
        vec![self.convolution.cpu(&inputs[0], &inputs[1], &epilogue)]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor, N>) -> [Option<CpuTensor>; N] {
        gradients(
            back,
            |operands, grad, add| self.convolution.cpu_backward_input(operands, grad, add),
            |operands, grad| self.convolution.cpu_backward_weight(operands, grad),
            |grad| {
                let [_, channels, height, width] = grad.dims();
                let sums = conv2d_backward_bias(grad.slice(), channels, height * width);
                CpuTensor::new(sums, [channels])
            },
        )
    }

    fn composed<B: Backend>(&self, inputs: [FloatTensor<B>; N]) -> Vec<FloatTensor<B>> {
        let mut inputs = Vec::from(inputs);
        let residual = inputs.drain(3..).next();
        let [input, weight, bias] = array(inputs);
        let options = self.convolution.options(input.shape()[1]);
        let sums = B::conv2d(input, weight, Some(bias), options);
        let sums = residual.into_iter().fold(sums, B::float_add);
        vec![activate_tensor::<B>(sums, self.activation)]
    }

    fn composed_backward<B: Backend>(
        &self,
        back: Backprop<FloatTensor<B>, N>,
    ) -> [Option<FloatTensor<B>>; N] {
        let options = |input: &FloatTensor<B>| self.convolution.options(input.shape()[1]);
        gradients(
            back,
            |[input, weight], grad, add| {
                let options = options(input);
                let d_input = B::conv2d_x_backward(input.clone(), weight.clone(), grad.clone(), options);
                add.cloned().into_iter().fold(d_input, B::float_add)
            },
            |[input, weight], grad| {
                B::conv2d_weight_backward(input.clone(), weight.clone(), grad.clone(), options(input))
            },
            |grad| {
                let channels = grad.shape()[1];
                let sums = [0, 2, 3].into_iter().fold(grad.clone(), B::float_sum_dim);
                B::float_reshape(sums, [channels].into())
            },
        )
    }
}

/// Of input, weight, bias and residual, from the gradient of the sums. Where the residual is the input as well, its gradient
/// is added to the input's on the way.
fn gradients<T: Clone, const N: usize>(
    back: Backprop<T, N>,
    of_input: impl Fn(&[T; 2], &T, Option<&T>) -> T,
    of_weight: impl Fn(&[T; 2], &T) -> T,
    of_bias: impl Fn(&T) -> T,
) -> [Option<T>; N] {
    let residual_is_input = back.are_one(0, 3);
    let wanted: [bool; N] = std::array::from_fn(|input| back.wants(input));
    let (operands, grad) = back.into_parts();
    std::array::from_fn(|input| match input {
        _ if !wanted[input] => None,
        0 => Some(of_input(&operands, &grad, residual_is_input.then_some(&grad))),
        1 => Some(of_weight(&operands, &grad)),
        2 => Some(of_bias(&grad)),
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

/// The convolution to an output of this size. Panics when the epilogue does not fit it.
pub(crate) fn convolve(
    convolution: impl Convolution,
    input: Tensor<4>,
    weight: Tensor<4>,
    epilogue: Epilogue,
    output: [usize; 4],
) -> Tensor<4> {
    let Epilogue { bias, residual, activation } = epilogue;
    let bias = bias.unwrap_or_else(|| Tensor::zeros([output[1]], &input.device()));
    assert_eq!(bias.dims(), [output[1]], "a bias for each output channel");
    let operation = Convolved { convolution, activation };
    let operands = [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()];
    let Some(residual) = residual else { return apply(operation, operands) };
    assert_eq!(residual.dims(), output, "a residual for each output element");
    let [input, weight, bias] = operands;
    apply(operation, [input, weight, bias, residual.into_dispatch()])
}
