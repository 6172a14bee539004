use burn::module::{Initializer, Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::Activation;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::instance_norm::tensor::group_norm;

/// Added to the variance; PyTorch's default.
const EPSILON: f64 = 1e-5;

/// PyTorch's `GroupNorm`.
#[derive(Module, Debug)]
pub struct GroupNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    groups: usize,
}

impl GroupNorm {
    /// A norm with weight 1 and bias 0.
    pub fn new(groups: usize, channels: usize, device: &Device) -> Self {
        Self {
            weight: Initializer::Ones.init([channels], device),
            bias: Initializer::Zeros.init([channels], device),
            groups,
        }
    }

    /// `activation(norm(x))` of `[batch, channels, height, width]`.
    pub fn forward(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        let normal = group_norm(x, self.groups, EPSILON, Activation::Identity);
        let weight = self.weight.val();
        let [channels] = weight.dims();
        let epilogue = Epilogue::with(activation).bias(Some(self.bias.val()));
        depthwise(normal, weight.reshape([channels, 1, 1, 1]), epilogue, [0, 0])
    }
}
