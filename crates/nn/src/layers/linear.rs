use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};

use super::conv::{bias_initializer, weight_initializer};

/// PyTorch's `Linear`: the weight is `[outputs, inputs]`.
#[derive(Module, Debug)]
pub struct Linear {
    weight: Param<Tensor<2>>,
    bias: Param<Tensor<1>>,
}

impl Linear {
    /// With random parameters, drawn when they are first read.
    pub fn new(inputs: usize, outputs: usize, device: &Device) -> Self {
        let fans = (Some(inputs), Some(outputs));
        Self {
            weight: weight_initializer().init_with([outputs, inputs], fans.0, fans.1, device),
            bias: bias_initializer().init_with([outputs], fans.0, fans.1, device),
        }
    }

    /// `[batch, outputs]` from `[batch, inputs]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.weight.val().transpose()) + self.bias.val().unsqueeze()
    }
}
