use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::Activation;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::instance_norm::tensor::group_norm;

use crate::Initializer;

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

    /// Sums over pixels and channels of each group that mean and variance follow from: of the numbers and of their squares,
    /// `[batch, groups]`.
    pub fn sums(&self, x: Tensor<4>) -> [Tensor<2>; 2] {
        let [batch, channels, _, _] = x.dims();
        let sum = |x: Tensor<4>| {
            let of_channels = x.sum_dim(3).sum_dim(2);
            of_channels
                .reshape([batch, self.groups, channels / self.groups])
                .sum_dim(2)
                .reshape([batch, self.groups])
        };
        [sum(x.clone()), sum(x.square())]
    }

    /// `norm(x)` of a part of a map with these sums over `count` pixels and channels of each group.
    pub fn forward_by(&self, x: Tensor<4>, [sum, squares]: &[Tensor<2>; 2], count: usize) -> Tensor<4> {
        let [batch, channels, _, _] = x.dims();
        let mean = sum.clone() / count as f64;
        let variance = (squares.clone() / count as f64 - mean.clone().square()).clamp_min(0.0);
        let of_channels = |x: Tensor<2>| {
            let x = x.reshape([batch, self.groups, 1]).repeat_dim(2, channels / self.groups);
            x.reshape([batch, channels, 1, 1])
        };
        let scale = of_channels((variance + EPSILON).sqrt().recip());
        let scale = scale * self.weight.val().reshape([1, channels, 1, 1]);
        let shift = self.bias.val().reshape([1, channels, 1, 1]) - of_channels(mean) * scale.clone();
        x * scale + shift
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
