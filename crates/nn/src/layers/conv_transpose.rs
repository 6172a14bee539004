//! Transposed convolutions with the parameters of PyTorch's `ConvTranspose2d`.

use burn::config::Config;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::conv_transpose2d::tensor::conv_transpose2d;
use srflow_ops::conv2d::tensor::Conv2dOptions;
use srflow_ops::{Activation, WeightCache};

use super::conv::{bias_initializer, weight_initializer};
use crate::Initializer;

/// Configuration of a [`ConvTranspose2d`].
#[derive(Config, Debug)]
pub struct ConvTranspose2dConfig {
    /// Input and output channels.
    channels: [usize; 2],
    /// Height and width.
    kernel: [usize; 2],
    /// Upsampling factor in both directions.
    #[config(default = "1")]
    stride: usize,
    /// Rows cropped above and below, and columns cropped left and right of the output.
    #[config(default = "[0, 0]")]
    padding: [usize; 2],
    #[config(default = "true")]
    bias: bool,
    /// Initializer of the weight.
    #[config(default = "weight_initializer()")]
    initializer: Initializer,
    /// Initializer of the bias.
    #[config(default = "bias_initializer()")]
    bias_initializer: Initializer,
}

/// PyTorch's `ConvTranspose2d`, with bias and activation in one operation.
#[derive(Module, Debug)]
pub struct ConvTranspose2d {
    weight: Param<Tensor<4>>,
    bias: Option<Param<Tensor<1>>>,
    stride: usize,
    padding: [usize; 2],
    #[module(skip)]
    cache: WeightCache,
}

impl ConvTranspose2dConfig {
    /// A layer with random parameters, drawn when they are first read.
    pub fn init(&self, device: &Device) -> ConvTranspose2d {
        let [inputs, outputs] = self.channels;
        // PyTorch, too, computes the fan-in from the second axis of the weight, which is the outputs here.
        let shape = [inputs, outputs, self.kernel[0], self.kernel[1]];
        let bias = || self.bias_initializer.init_bias(outputs, &shape, device);
        ConvTranspose2d {
            weight: self.initializer.init(shape, device),
            bias: self.bias.then(bias),
            stride: self.stride,
            padding: self.padding,
            cache: WeightCache::default(),
        }
    }
}

impl ConvTranspose2d {
    /// `activation(conv_transpose(x) + bias)` of `[batch, inputs, height, width]`.
    pub fn forward(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        let Self { stride, padding, .. } = *self;
        let options = Conv2dOptions { stride: [stride; 2], padding, cache: self.cache.clone() };
        conv_transpose2d(x, self.weight.val(), self.bias.as_ref().map(Param::val), activation, options)
    }
}
