//! Convolutions with the parameters of PyTorch's `Conv2d`.

use burn::config::Config;
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::pointwise::tensor::{LayerOptions, PointwiseLayer};
use srflow_ops::{Activation, WeightCache};

use crate::Initializer;

/// Configuration of a [`Conv2d`].
#[derive(Config, Debug)]
pub struct Conv2dConfig {
    /// Input and output channels.
    channels: [usize; 2],
    /// Height and width.
    kernel: [usize; 2],
    /// In both directions.
    #[config(default = "1")]
    stride: usize,
    /// Zeros above and below, and left and right; by default half the kernel, which keeps the size for stride 1 and odd kernels.
    padding: Option<[usize; 2]>,
    /// One kernel per channel.
    #[config(default = "false")]
    depthwise: bool,
    #[config(default = "true")]
    bias: bool,
    /// Initializer of the weight.
    #[config(default = "weight_initializer()")]
    initializer: Initializer,
    /// Initializer of the bias.
    #[config(default = "bias_initializer()")]
    bias_initializer: Initializer,
}

/// PyTorch's default for weights: uniform within `1 / sqrt(fan_in)`.
pub(super) fn weight_initializer() -> Initializer {
    Initializer::KaimingUniform { gain: 0.577_350_269_189_625_8, fan_out_only: false }
}

/// PyTorch's default for biases: uniform within `1 / sqrt(fan_in)`.
pub(super) fn bias_initializer() -> Initializer {
    Initializer::KaimingUniform { gain: 1.0 / 3.0_f64.sqrt(), fan_out_only: false }
}

/// PyTorch's `Conv2d`, dense or depthwise, with bias, residual and activation in one operation.
#[derive(Module, Debug)]
pub struct Conv2d {
    weight: Param<Tensor<4>>,
    bias: Option<Param<Tensor<1>>>,
    stride: usize,
    padding: [usize; 2],
    depthwise: bool,
    #[module(skip)]
    cache: WeightCache,
}

impl Conv2dConfig {
    /// A layer with random parameters, drawn when they are first read.
    pub fn init(&self, device: &Device) -> Conv2d {
        let [inputs, outputs] = self.channels;
        let group = if self.depthwise { 1 } else { inputs };
        let shape = [outputs, group, self.kernel[0], self.kernel[1]];
        Conv2d {
            weight: self.initializer.init(shape, device),
            bias: self.bias.then(|| self.bias_initializer.init_bias(outputs, &shape, device)),
            stride: self.stride,
            padding: self.padding.unwrap_or(self.kernel.map(|side| side / 2)),
            depthwise: self.depthwise,
            cache: WeightCache::default(),
        }
    }
}

impl Conv2d {
    #[cfg(test)]
    pub(super) fn filled(self, weight: Tensor<4>, bias: Tensor<1>) -> Self {
        Self { weight: Param::from_tensor(weight), bias: Some(Param::from_tensor(bias)), ..self }
    }

    /// `[outputs, inputs, height, width]`; `inputs` is 1 for a depthwise convolution.
    pub fn weight(&self) -> Tensor<4> {
        self.weight.val()
    }

    /// `[outputs]`.
    pub fn bias(&self) -> Option<Tensor<1>> {
        self.bias.as_ref().map(Param::val)
    }

    /// `activation(conv(x) + bias)` of `[batch, inputs, height, width]`.
    pub fn forward(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        self.with_epilogue(x, Epilogue::with(activation).bias(self.bias()))
    }

    /// `conv(x)` without the bias.
    pub(super) fn forward_without_bias(&self, x: Tensor<4>) -> Tensor<4> {
        self.with_epilogue(x, Epilogue::default())
    }

    /// `activation(conv(x) + bias + residual)`; `residual` has the shape of the output.
    pub fn forward_add(&self, x: Tensor<4>, residual: Tensor<4>, activation: Activation) -> Tensor<4> {
        self.with_epilogue(x, Epilogue::with(activation).bias(self.bias()).residual(residual))
    }

    /// Partial kernel convolution (Morimitsu et al., *RPKNet*, AAAI 2024): uses the part of the kernel for the first `outputs`
    /// output channels and as many input channels as `x` has. Panics when the convolution has fewer outputs.
    pub fn partial(&self, x: Tensor<4>, outputs: usize, epilogue: Epilogue) -> Tensor<4> {
        let weight = self.weight();
        let inputs = weight.dims()[1].min(x.dims()[1]);
        let weight = weight.narrow(0, 0, outputs).narrow(1, 0, inputs);
        let bias = self.bias().map(|bias| bias.narrow(0, 0, outputs));
        self.apply(x, weight, &self.cache, epilogue.bias(bias))
    }

    fn with_epilogue(&self, x: Tensor<4>, epilogue: Epilogue) -> Tensor<4> {
        self.apply(x, self.weight(), &self.cache, epilogue)
    }

    /// Convolves with another weight of the same kernel size; `cache` belongs to that weight. The bias is that of `epilogue`.
    pub fn apply(
        &self,
        x: Tensor<4>,
        weight: Tensor<4>,
        cache: &WeightCache,
        epilogue: Epilogue,
    ) -> Tensor<4> {
        let Self { stride, padding, .. } = *self;
        if self.depthwise {
            depthwise(x, weight, epilogue, padding)
        } else {
            conv2d(x, weight, epilogue, Conv2dOptions { stride: [stride; 2], padding, cache: cache.clone() })
        }
    }

    /// Whether every output pixel depends only on the same input pixel.
    pub fn is_pointwise(&self) -> bool {
        self.stride == 1 && self.weight.lazy_shape()[2..] == [1, 1]
    }

    /// This convolution, which must be [pointwise](Self::is_pointwise), as a layer of
    /// [`pointwise_layers`](srflow_ops::pointwise::tensor::pointwise_layers).
    pub fn layer(&self, add_input_of: Option<usize>, activation: Activation) -> PointwiseLayer {
        let weight = self.weight();
        let bias = self.bias().unwrap_or_else(|| Tensor::zeros([weight.dims()[0]], &weight.device()));
        let options =
            LayerOptions { scale: self.depthwise, add_input_of, activation, cache: self.cache.clone() };
        PointwiseLayer { weight, bias, options }
    }
}
