use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::Activation;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::layer_norm::tensor::layer_norm;

use crate::Initializer;

/// PyTorch's `LayerNorm` over the channels of each pixel.
#[derive(Module, Debug)]
pub struct LayerNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    epsilon: f64,
}

impl LayerNorm {
    /// Weight 1, bias 0; `epsilon` is added to the variance.
    pub fn new(channels: usize, epsilon: f64, device: &Device) -> Self {
        Self {
            weight: Initializer::Ones.init([channels], device),
            bias: Initializer::Zeros.init([channels], device),
            epsilon,
        }
    }

    /// Weight and bias, `[channels]` each.
    pub fn weight_and_bias(&self) -> [Tensor<1>; 2] {
        [self.weight.val(), self.bias.val()]
    }

    /// Normalizes `[batch, channels, height, width]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.with_epilogue(x, Epilogue::default())
    }

    /// `norm(x) + residual`; `residual` has the shape of `x`.
    pub fn forward_add(&self, x: Tensor<4>, residual: Tensor<4>) -> Tensor<4> {
        self.with_epilogue(x, Epilogue::default().residual(residual))
    }

    fn with_epilogue(&self, x: Tensor<4>, epilogue: Epilogue) -> Tensor<4> {
        let normal = layer_norm(x, self.epsilon, Activation::Identity);
        let scale = self.weight.val();
        let channels = scale.dims()[0];
        depthwise(normal, scale.reshape([channels, 1, 1, 1]), epilogue.bias(Some(self.bias.val())), [0, 0])
    }
}
