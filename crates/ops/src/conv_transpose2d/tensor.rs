//! The transposed convolution on tensors: [`conv_transpose2d`] with gradients.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::ops::ConvTransposeOptions;
use burn::tensor::{Shape, Tensor};
use srflow_simd::Isa;

use crate::Activation;
use crate::activation::activate_tensor;
use crate::conv2d::tensor::Conv2dOptions;
use crate::conv2d::{
    Epilogue, backward_input_packed, conv2d_backward_bias, conv2d_backward_weight, convolve_packed,
};
use crate::convolution::Conv2dShape;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Composition, Operation, apply};
use crate::weight_cache::Pass;

/// Of input, weight and bias.
#[derive(Debug, Clone)]
pub(super) struct ConvTranspose2d {
    pub(super) options: Conv2dOptions,
    pub(super) activation: Activation,
}

/// Sizes of the convolution that goes the other way.
pub(super) fn shape_of(options: &Conv2dOptions, input: Shape, weight: Shape) -> Conv2dShape {
    let [batch, out_channels, height, width] = input.dims();
    let [_, in_channels, kernel_height, kernel_width] = weight.dims();
    let (rows, kernel) = ([height, width], [kernel_height, kernel_width]);
    let size = [0, 1].map(|i| {
        let grown = rows[i].saturating_sub(1) * options.stride[i] + kernel[i];
        grown.saturating_sub(2 * options.padding[i])
    });
    Conv2dShape {
        batch,
        in_channels,
        out_channels,
        groups: 1,
        input: size,
        kernel,
        stride: options.stride,
        padding: options.padding,
    }
}

impl ConvTranspose2d {
    fn shape(&self, input: Shape, weight: Shape) -> Conv2dShape {
        shape_of(&self.options, input, weight)
    }
}

impl Composition<3> for ConvTranspose2d {
    fn composed<B: Backend>(&self, [input, weight, bias]: [FloatTensor<B>; 3]) -> Vec<FloatTensor<B>> {
        let Conv2dOptions { stride, padding, .. } = self.options;
        let options = ConvTransposeOptions::new(stride, padding, [0, 0], [1, 1], 1);
        let sums = B::conv_transpose2d(input, weight, Some(bias), options);
        vec![activate_tensor::<B>(sums, self.activation)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 3] {
        let ([input, weight], grad) = back.into_parts();
        let shape = self.shape(input.shape(), weight.shape());
        let sums = [0, 2, 3].into_iter().fold(grad.clone(), B::float_sum_dim);
        let d_bias = B::float_reshape(sums, [shape.in_channels].into());
        let d_input = B::conv2d(grad.clone(), weight.clone(), None, shape.options());
        let d_weight = B::conv2d_weight_backward(grad, weight, input, shape.options());
        [Some(d_input), Some(d_weight), Some(d_bias)]
    }
}

impl Operation<3> for ConvTranspose2d {
    fn activation(&mut self) -> Option<&mut Activation> {
        Some(&mut self.activation)
    }

    fn saved_inputs<T>(inputs: &[T; 3]) -> &[T] {
        &inputs[..2]
    }

    fn cpu(&self, [input, weight, bias]: [CpuTensor; 3]) -> Vec<CpuTensor> {
        let shape = self.shape(input.shape(), weight.shape());
        let packed = self.options.packed(Pass::Backward, &weight, &shape);
        let epilogue = Epilogue { bias: Some(bias.slice()), residual: None, activation: self.activation };
        let out = backward_input_packed(Isa::best(), input.slice(), &packed, &epilogue, &shape);
        vec![CpuTensor::new(out, shape.input_shape())]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 3] {
        let wanted = [0, 1, 2].map(|input| back.wants(input));
        let ([input, weight], grad) = back.into_parts();
        let shape = self.shape(input.shape(), weight.shape());
        let of_input = || {
            let packed = self.options.packed(Pass::Forward, &weight, &shape);
            input.like(convolve_packed(Isa::best(), grad.slice(), &packed, &Epilogue::default(), &shape))
        };
        let of_weight = || weight.like(conv2d_backward_weight(grad.slice(), input.slice(), &shape));
        let of_bias = || {
            let pixels = shape.input[0] * shape.input[1];
            CpuTensor::new(conv2d_backward_bias(grad.slice(), shape.in_channels, pixels), [shape.in_channels])
        };
        [wanted[0].then(of_input), wanted[1].then(of_weight), wanted[2].then(of_bias)]
    }
}

/// `activation(sums + bias)` of the transposed convolution of `input` (`[batch, in_channels, height, width]`) with `weight`
/// (`[in_channels, out_channels, kernel_height, kernel_width]`): `[batch, out_channels, out_height, out_width]`, where
/// `out_height = (height - 1) * stride - 2 * padding + kernel_height`, and likewise the width. Stride and padding are those of
/// the convolution that goes the other way.
///
/// Panics when the sizes do not fit each other or nothing would be left of the output.
pub fn conv_transpose2d(
    input: Tensor<4>,
    weight: Tensor<4>,
    bias: Option<Tensor<1>>,
    activation: Activation,
    options: Conv2dOptions,
) -> Tensor<4> {
    assert_eq!(
        weight.dims()[0],
        input.dims()[1],
        "conv_transpose2d: channels of the weight and of the input"
    );
    let shape = shape_of(&options, input.shape(), weight.shape());
    let [_, _, height, width] = input.dims();
    assert!(
        shape.output() == [height, width] && height * width * shape.input_len() > 0,
        "conv_transpose2d: nothing is left of the output: {shape:?}"
    );
    let bias = bias.unwrap_or_else(|| Tensor::zeros([shape.in_channels], &input.device()));
    assert_eq!(bias.dims(), [shape.in_channels], "a bias for each output channel");
    let operation = ConvTranspose2d { options, activation };
    apply(operation, [input.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()])
}
