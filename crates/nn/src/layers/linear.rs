use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::{Activation, WeightCache};

use super::conv::{bias_initializer, weight_initializer};

/// PyTorch's `Linear`: the weight is `[outputs, inputs]`.
#[derive(Module, Debug)]
pub struct Linear {
    weight: Param<Tensor<2>>,
    bias: Param<Tensor<1>>,
    #[module(skip)]
    cache: WeightCache,
}

impl Linear {
    /// A layer with random parameters, drawn when they are first read.
    pub fn new(inputs: usize, outputs: usize, device: &Device) -> Self {
        let fans = (Some(inputs), Some(outputs));
        Self {
            weight: weight_initializer().init_with([outputs, inputs], fans.0, fans.1, device),
            bias: bias_initializer().init_with([outputs], fans.0, fans.1, device),
            cache: WeightCache::default(),
        }
    }

    /// `[batch, outputs]` from `[batch, inputs]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.weight.val().transpose()) + self.bias.val().unsqueeze()
    }

    /// `activation(linear(x))` per pixel: `[batch, outputs, height, width]` from `[batch, inputs, height, width]`.
    pub fn forward_pixels(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        let epilogue = Epilogue::with(activation).bias(Some(self.bias()));
        let options = Conv2dOptions { stride: [1, 1], padding: [0, 0], cache: self.cache.clone() };
        conv2d(x, self.kernel(), epilogue, options)
    }

    /// The weight as that of a 1x1 convolution, `[outputs, inputs, 1, 1]`.
    pub fn kernel(&self) -> Tensor<4> {
        let weight = self.weight.val();
        let [outputs, inputs] = weight.dims();
        weight.reshape([outputs, inputs, 1, 1])
    }

    /// `[outputs]`.
    pub fn bias(&self) -> Tensor<1> {
        self.bias.val()
    }
}
