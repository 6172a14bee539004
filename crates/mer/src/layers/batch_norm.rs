use burn::module::{Initializer, Module, Param, RunningState};
use burn::tensor::{Device, Tensor, activation::relu};
use srflow_ops::batch_norm::tensor::batch_norm;

use super::{Conv2d, Mode};

/// Added to the variance; PyTorch's default.
const EPSILON: f64 = 1e-5;

/// PyTorch's `BatchNorm2d`.
#[derive(Module, Debug)]
pub(crate) struct BatchNorm2d {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    running_mean: RunningState<Tensor<1>>,
    running_var: RunningState<Tensor<1>>,
}

impl BatchNorm2d {
    pub(crate) fn new(channels: usize, device: &Device) -> Self {
        Self {
            weight: Initializer::Ones.init([channels], device),
            bias: Initializer::Zeros.init([channels], device),
            running_mean: RunningState::new(Tensor::zeros([channels], device)),
            running_var: RunningState::new(Tensor::ones([channels], device)),
        }
    }

    /// `norm(x)`.
    pub(crate) fn forward(&self, x: Tensor<4>, mode: &Mode) -> Tensor<4> {
        self.normalized(x, None, false, mode)
    }

    /// `relu(norm(conv(x)))`. The norm takes away whatever the convolution's bias adds, so that in training the bias is
    /// only seen by the running mean and has no gradient.
    pub(crate) fn relu_after(&self, conv: &Conv2d, x: Tensor<4>, mode: &Mode) -> Tensor<4> {
        self.normalized(conv.forward_without_bias(x), conv.bias(), true, mode)
    }

    /// Of `x + offset`, `offset` one number a channel.
    fn normalized(&self, x: Tensor<4>, offset: Option<Tensor<1>>, rectify: bool, mode: &Mode) -> Tensor<4> {
        let [_, channels, _, _] = x.dims();
        match mode {
            Mode::Training { .. } => {
                let mut norm = batch_norm(x, self.weight.val(), self.bias.val(), rectify);
                if let Some(offset) = offset {
                    norm.mean = norm.mean + offset.detach();
                }
                let found = norm.running(self.running_mean.value_sync(), self.running_var.value_sync());
                for (running, found) in [&self.running_mean, &self.running_var].into_iter().zip(found) {
                    running.update(found);
                }
                norm.output
            }
            Mode::Evaluation => {
                let scale = self.weight.val() / (self.running_var.value_sync() + EPSILON).sqrt();
                let centre = match offset {
                    Some(offset) => self.running_mean.value_sync() - offset,
                    None => self.running_mean.value_sync(),
                };
                let shift = self.bias.val() - centre * scale.clone();
                let of_channels = |values: Tensor<1>| values.reshape([1, channels, 1, 1]);
                let output = x * of_channels(scale) + of_channels(shift);
                if rectify { relu(output) } else { output }
            }
        }
    }
}
