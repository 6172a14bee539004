use burn::config::Config;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::pointwise::tensor::{LayerOptions, PointwiseLayer};
use srflow_ops::{Activation, WeightCache};

use super::conv::{bias_initializer, weight_initializer};
use crate::Initializer;

/// Configuration of a [`Linear`].
#[derive(Config, Debug)]
pub struct LinearConfig {
    inputs: usize,
    outputs: usize,
    #[config(default = "true")]
    bias: bool,
    /// Initializer of the weight.
    #[config(default = "weight_initializer()")]
    initializer: Initializer,
}

/// PyTorch's `Linear`: the weight is `[outputs, inputs]`.
#[derive(Module, Debug)]
pub struct Linear {
    weight: Param<Tensor<2>>,
    bias: Option<Param<Tensor<1>>>,
    #[module(skip)]
    cache: WeightCache,
}

impl LinearConfig {
    /// A layer with random parameters, drawn when they are first read.
    pub fn init(&self, device: &Device) -> Linear {
        let Self { inputs, outputs, bias, .. } = *self;
        let shape = [outputs, inputs];
        Linear {
            weight: self.initializer.init(shape, device),
            bias: bias.then(|| bias_initializer().init_bias(outputs, &shape, device)),
            cache: WeightCache::default(),
        }
    }
}

impl Linear {
    /// `[batch, outputs]` from `[batch, inputs]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        let products = x.matmul(self.weight.val().transpose());
        match self.bias() {
            Some(bias) => products + bias.unsqueeze(),
            None => products,
        }
    }

    /// `activation(linear(x))` per pixel: `[batch, outputs, height, width]` from `[batch, inputs, height, width]`.
    pub fn forward_pixels(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        let epilogue = Epilogue::with(activation).bias(self.bias());
        let options = Conv2dOptions { stride: [1, 1], padding: [0, 0], cache: self.cache.clone() };
        conv2d(x, self.kernel(), epilogue, options)
    }

    /// This layer as a layer of [`pointwise_layers`](srflow_ops::pointwise::tensor::pointwise_layers).
    pub fn layer(&self, activation: Activation) -> PointwiseLayer {
        let weight = self.kernel();
        let bias = self.bias().unwrap_or_else(|| Tensor::zeros([weight.dims()[0]], &weight.device()));
        let options = LayerOptions { activation, cache: self.cache.clone(), ..LayerOptions::default() };
        PointwiseLayer { weight, bias, options }
    }

    /// The weight as that of a 1x1 convolution, `[outputs, inputs, 1, 1]`.
    pub fn kernel(&self) -> Tensor<4> {
        let weight = self.weight.val();
        let [outputs, inputs] = weight.dims();
        weight.reshape([outputs, inputs, 1, 1])
    }

    /// `[outputs]`.
    pub fn bias(&self) -> Option<Tensor<1>> {
        self.bias.as_ref().map(Param::val)
    }
}
