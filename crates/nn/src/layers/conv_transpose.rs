//! Transposed convolutions with the parameters of PyTorch's `ConvTranspose2d`.

use burn::config::Config;
use burn::module::{Initializer, Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::conv_transpose2d::tensor::conv_transpose2d;
use srflow_ops::conv2d::tensor::Conv2dOptions;
use srflow_ops::{Activation, WeightCache};

use super::conv::{bias_initializer, weight_initializer};

/// How a [`ConvTranspose2d`] is made.
#[derive(Config, Debug)]
pub struct ConvTranspose2dConfig {
    /// Input and output channels.
    channels: [usize; 2],
    /// Height and width.
    kernel: [usize; 2],
    /// Pixels of the output for each of the input, down and across.
    #[config(default = "1")]
    stride: usize,
    /// Rows above and below, and columns left and right, that the output lacks.
    #[config(default = "[0, 0]")]
    padding: [usize; 2],
    /// Add a number to each output channel.
    #[config(default = "true")]
    bias: bool,
    /// Of the weight.
    #[config(default = "weight_initializer()")]
    initializer: Initializer,
    /// Of the bias.
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
    /// With random parameters, drawn when they are first read.
    pub fn init(&self, device: &Device) -> ConvTranspose2d {
        let [inputs, outputs] = self.channels;
        let taps = self.kernel[0] * self.kernel[1];
        // PyTorch takes the outputs for inputs here: the weight's second axis.
        let fans = (Some(outputs * taps), Some(inputs * taps));
        let shape = [inputs, outputs, self.kernel[0], self.kernel[1]];
        let bias = || self.bias_initializer.init_with([outputs], fans.0, fans.1, device);
        ConvTranspose2d {
            weight: self.initializer.init_with(shape, fans.0, fans.1, device),
            bias: self.bias.then(bias),
            stride: self.stride,
            padding: self.padding,
            cache: WeightCache::default(),
        }
    }
}

impl ConvTranspose2d {
    /// `activation(conv_transpose(x) + bias)`.
    pub fn forward(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        let Self { stride, padding, .. } = *self;
        let options = Conv2dOptions { stride: [stride; 2], padding, cache: self.cache.clone() };
        conv_transpose2d(x, self.weight.val(), self.bias.as_ref().map(Param::val), activation, options)
    }
}
