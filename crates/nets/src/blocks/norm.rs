//! What normalizes the output of an encoder's convolution.

use burn::module::{Initializer, Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::conv2d::tensor::Finish;
use srflow_ops::instance_norm::tensor::instance_norm;
use srflow_ops::{Activation, WeightCache};

use super::Conv2d;

/// Added to the variance; PyTorch's default.
const EPSILON: f64 = 1e-5;

/// Which normalization an encoder has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NormKind {
    None,
    Instance,
    Batch,
}

/// A normalization and, for batch norm, its parameters under PyTorch's names.
///
/// Batch norm always uses the running statistics: the networks are fine-tuned with them frozen, and estimate with them.
#[derive(Module, Debug)]
pub(crate) struct Norm {
    weight: Option<Param<Tensor<1>>>,
    bias: Option<Param<Tensor<1>>>,
    running_mean: Option<Param<Tensor<1>>>,
    running_var: Option<Param<Tensor<1>>>,
    instance: bool,
}

impl Norm {
    pub(crate) fn new(kind: NormKind, channels: usize, device: &Device) -> Self {
        let parameter = |initializer: Initializer| -> Option<Param<Tensor<1>>> {
            (kind == NormKind::Batch).then(|| initializer.init([channels], device))
        };
        let statistic = |initializer| parameter(initializer).map(|param| param.set_require_grad(false));
        Self {
            weight: parameter(Initializer::Ones),
            bias: parameter(Initializer::Zeros),
            running_mean: statistic(Initializer::Zeros),
            running_var: statistic(Initializer::Ones),
            instance: kind == NormKind::Instance,
        }
    }

    /// `activation(norm(conv(x)))`. Batch norm is folded into the convolution.
    pub(crate) fn after(&self, conv: &Conv2d, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        if self.instance {
            return instance_norm(conv.forward(x, Activation::Identity), activation);
        }
        let (Some(weight), Some(bias), Some(mean), Some(variance)) =
            (&self.weight, &self.bias, &self.running_mean, &self.running_var)
        else {
            return conv.forward(x, activation);
        };
        let scale = weight.val() / (variance.val() + EPSILON).sqrt();
        let mut shift = bias.val() - mean.val() * scale.clone();
        if let Some(bias) = conv.bias() {
            shift = shift + bias * scale.clone();
        }
        let channels = scale.dims()[0];
        let folded = conv.weight() * scale.reshape([channels, 1, 1, 1]);
        conv.apply(x, folded, &WeightCache::default(), Finish::with(activation).bias(Some(shift)))
    }
}
