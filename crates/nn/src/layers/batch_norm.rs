//! PyTorch's `BatchNorm2d` and its running statistics.

use burn::module::{Flag, Module, ModuleMapper, Param, RunningState};
use burn::tensor::activation::{gelu, leaky_relu, relu, sigmoid};
use burn::tensor::{Device, Tensor};
use srflow_ops::batch_norm::tensor::batch_norm;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::{Activation, WeightCache};

use super::Conv2d;
use crate::Initializer;

/// Added to the variance; PyTorch's default.
const EPSILON: f64 = 1e-5;

/// PyTorch's `BatchNorm2d`, by the running statistics or by those of the batch; see [`with_batch_statistics`].
#[derive(Module, Debug)]
pub struct BatchNorm {
    weight: Param<Tensor<1>>,
    bias: Param<Tensor<1>>,
    running_mean: RunningState<Tensor<1>>,
    running_var: RunningState<Tensor<1>>,
    batch_statistics: Param<Flag>,
}

/// Sets whether all batch norms of a network use mean and variance of the batch (`true`, as PyTorch in training mode) or the
/// running statistics (`false`, the default). With `true`, every forward pass also updates the running statistics. The result
/// of [`Module::valid`] has `false`.
pub fn with_batch_statistics<M: Module>(network: M, batch_statistics: bool) -> M {
    struct SetFlag(bool);

    impl ModuleMapper for SetFlag {
        fn map_flag(&mut self, flag: Param<Flag>) -> Param<Flag> {
            flag.with_value(self.0)
        }
    }

    network.map(&mut SetFlag(batch_statistics))
}

impl BatchNorm {
    /// Weight 1, bias 0, running mean 0, running variance 1.
    pub fn new(channels: usize, device: &Device) -> Self {
        Self {
            weight: Initializer::Ones.init([channels], device),
            bias: Initializer::Zeros.init([channels], device),
            running_mean: RunningState::new(Tensor::zeros([channels], device)),
            running_var: RunningState::new(Tensor::ones([channels], device)),
            batch_statistics: Param::from_bool(false),
        }
    }

    /// `norm(x)` of `[batch, channels, height, width]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.normalize(x, None, false)
    }

    /// `relu(norm(conv(x)))`. With batch statistics the norm cancels the bias of the convolution, which then only enters the
    /// running mean and has no gradient.
    pub fn relu_after(&self, conv: &Conv2d, x: Tensor<4>) -> Tensor<4> {
        self.normalize(conv.forward_without_bias(x), conv.bias(), true)
    }

    /// `activation(norm(conv(x)))`. Running statistics are folded into the convolution. With batch statistics the gradient of its
    /// bias is only rounding error, as in PyTorch.
    pub fn after(&self, conv: &Conv2d, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        if self.batch_statistics.val().is_enabled() {
            let y = conv.forward(x, Activation::Identity);
            let y = self.normalize_by_batch(y, None, activation == Activation::Relu);
            return match activation {
                Activation::Identity | Activation::Relu => y,
                Activation::LeakyRelu => leaky_relu(y, f64::from(Activation::LEAK)),
                Activation::Gelu => gelu(y),
                Activation::Tanh => y.tanh(),
                Activation::Sigmoid => sigmoid(y),
            };
        }
        let [scale, mut shift] = self.scale_and_shift(None);
        if let Some(bias) = conv.bias() {
            shift = shift + bias * scale.clone();
        }
        let channels = scale.dims()[0];
        let folded = conv.weight() * scale.reshape([channels, 1, 1, 1]);
        conv.apply(x, folded, &WeightCache::default(), Epilogue::with(activation).bias(Some(shift)))
    }

    /// Normalizes `x + offset`, with an `offset` per channel.
    fn normalize(&self, x: Tensor<4>, offset: Option<Tensor<1>>, rectify: bool) -> Tensor<4> {
        if self.batch_statistics.val().is_enabled() {
            return self.normalize_by_batch(x, offset, rectify);
        }
        let [scale, shift] = self.scale_and_shift(offset);
        let channels = x.dims()[1];
        let of_channels = |values: Tensor<1>| values.reshape([1, channels, 1, 1]);
        let output = x * of_channels(scale) + of_channels(shift);
        if rectify { relu(output) } else { output }
    }

    /// Normalizes `x + offset` by its own statistics, and updates the running ones.
    fn normalize_by_batch(&self, x: Tensor<4>, offset: Option<Tensor<1>>, rectify: bool) -> Tensor<4> {
        let mut norm = batch_norm(x, self.weight.val(), self.bias.val(), rectify);
        if let Some(offset) = offset {
            norm.mean = norm.mean + offset.detach();
        }
        let found = norm.running(self.running_mean.value(), self.running_var.value());
        for (running, found) in [&self.running_mean, &self.running_var].into_iter().zip(found) {
            running.update(found);
            running.value_sync();
        }
        norm.output
    }

    /// Scale and shift of each channel that normalize `x + offset` by the running statistics: `x * scale + shift`.
    fn scale_and_shift(&self, offset: Option<Tensor<1>>) -> [Tensor<1>; 2] {
        let scale = self.weight.val() / (self.running_var.value() + EPSILON).sqrt();
        let centre = match offset {
            Some(offset) => self.running_mean.value() - offset,
            None => self.running_mean.value(),
        };
        let shift = self.bias.val() - centre * scale.clone();
        [scale, shift]
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;

    use super::*;
    use crate::layers::Conv2dConfig;

    const OUT: [f32; 6] = [0.0, 0.794589, 0.583567, 0.067639, 0.0, 0.0];
    const MEAN: [f32; 3] = [-0.087306, -0.140868, -0.190465];
    const VARIANCE: [f32; 3] = [0.870859, 0.837585, 0.813205];
    const X_GRADIENT: [f32; 4] = [-1.536953, -0.016417, -0.124503, -0.121898];
    const CONV_GRADIENT: [f32; 6] = [0.371087, -0.271371, -0.149794, 0.233731, 0.551009, 1.955341];
    const WEIGHT_GRADIENT: [f32; 3] = [0.751107, 2.846398, -0.100006];

    fn numbers<const D: usize>(shape: [usize; D], seed: usize, device: &Device) -> Tensor<D> {
        let count: usize = shape.iter().product();
        let value = |i: usize| ((i * 7919 + seed * 104_729) % 2048) as f32 / 1024.0 - 1.0;
        Tensor::from_data(TensorData::new((0..count).map(value).collect(), shape), device)
    }

    fn assert_close<const D: usize>(what: &str, found: Tensor<D>, expected: &[f32]) {
        let found: Vec<f32> = found.into_data().try_to_vec().expect("f32");
        assert_eq!(found.len(), expected.len(), "{what}");
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 2e-5, "{what}: {found}, {expected}");
        }
    }

    /// Golden values: `tools/parity/batch_norm.py`.
    #[test]
    fn training_matches_pytorch() {
        let device = Device::flex().autodiff();
        let conv = Conv2dConfig::new([2, 3], [1, 1]).init(&device);
        let conv = conv.filled(numbers([3, 2, 1, 1], 1, &device), numbers([3], 2, &device));
        let mut norm = BatchNorm::new(3, &device);
        norm.weight = Param::from_tensor(numbers([3], 3, &device));
        norm.bias = Param::from_tensor(numbers([3], 4, &device));
        let norm = with_batch_statistics(norm, true);
        norm.after(&conv, numbers([2, 2, 3, 4], 5, &device), Activation::Relu);
        let x = numbers([2, 2, 3, 4], 6, &device).require_grad();
        let out = norm.after(&conv, x.clone(), Activation::Relu);
        let at = |x: Tensor<4>| x.narrow(2, 1, 1).narrow(3, 2, 1);
        assert_close("output", at(out.clone()), &OUT);
        let grads = (out * numbers([2, 3, 3, 4], 7, &device)).sum().backward();
        assert_close("running mean", norm.running_mean.value(), &MEAN);
        assert_close("running variance", norm.running_var.value(), &VARIANCE);
        assert_close("gradient of x", at(x.grad(&grads).expect("a gradient")), &X_GRADIENT);
        assert_close("of the convolution", conv.weight().grad(&grads).expect("a gradient"), &CONV_GRADIENT);
        let weight = norm.weight.val();
        assert_close("of the weight", weight.grad(&grads).expect("a gradient"), &WEIGHT_GRADIENT);
    }

    #[test]
    fn running_statistics_converge_to_those_of_the_batch() {
        let device = Device::flex();
        let conv = Conv2dConfig::new([2, 3], [1, 1]).init(&device);
        let norm = with_batch_statistics(BatchNorm::new(3, &device), true);
        let x = numbers([2, 2, 30, 40], 5, &device);
        for _ in 0..200 {
            norm.after(&conv, x.clone(), Activation::Identity);
        }
        let trained: Vec<f32> =
            norm.after(&conv, x.clone(), Activation::Identity).into_data().try_to_vec().expect("f32");
        let running = with_batch_statistics(norm, false).after(&conv, x, Activation::Identity);
        let running: Vec<f32> = running.into_data().try_to_vec().expect("f32");
        for (trained, running) in trained.iter().zip(&running) {
            assert!((trained - running).abs() < 5e-3, "{trained}, {running}");
        }
    }
}
