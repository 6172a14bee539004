use burn::module::{Initializer, Module, Param};
use burn::tensor::{Device, Tensor};

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

    /// Normalizes `[batch, channels, height, width]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let channels = x.dims()[1];
        let of_channels = |values: Tensor<1>| values.reshape([1, channels, 1, 1]);
        let centred = x.clone() - x.mean_dim(1);
        let variance = centred.clone().square().mean_dim(1);
        let normal = centred / (variance + self.epsilon).sqrt();
        normal * of_channels(self.weight.val()) + of_channels(self.bias.val())
    }
}
