//! What normalizes the output of an encoder's convolution.

use burn::module::{Flag, Initializer, Module, ModuleMapper, Param, RunningState};
use burn::tensor::activation::{gelu, sigmoid};
use burn::tensor::{Device, Tensor};
use srflow_ops::batch_norm::tensor::batch_norm;
use srflow_ops::conv2d::tensor::Epilogue;
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
/// Batch norm uses the running statistics, unless [`with_batch_statistics`] says otherwise.
#[derive(Module, Debug)]
pub(crate) struct Norm {
    weight: Option<Param<Tensor<1>>>,
    bias: Option<Param<Tensor<1>>>,
    running_mean: Option<RunningState<Tensor<1>>>,
    running_var: Option<RunningState<Tensor<1>>>,
    instance: bool,
    batch_statistics: Param<Flag>,
}

/// Sets whether batch norm takes mean and variance from the batch (`true`, as PyTorch's modules do in training) or from the
/// running statistics (`false`). With the first, every forward pass also moves the running statistics towards those of its
/// batch.
pub fn with_batch_statistics<M: Module>(network: M, batch_statistics: bool) -> M {
    struct Setting(bool);

    impl ModuleMapper for Setting {
        fn map_flag(&mut self, flag: Param<Flag>) -> Param<Flag> {
            flag.with_value(self.0)
        }
    }

    network.map(&mut Setting(batch_statistics))
}

impl Norm {
    pub(crate) fn new(kind: NormKind, channels: usize, device: &Device) -> Self {
        let parameter = |initializer: Initializer| -> Option<Param<Tensor<1>>> {
            (kind == NormKind::Batch).then(|| initializer.init([channels], device))
        };
        let statistic = |value: Tensor<1>| (kind == NormKind::Batch).then(|| RunningState::new(value));
        Self {
            weight: parameter(Initializer::Ones),
            bias: parameter(Initializer::Zeros),
            running_mean: statistic(Tensor::zeros([channels], device)),
            running_var: statistic(Tensor::ones([channels], device)),
            instance: kind == NormKind::Instance,
            batch_statistics: Param::from_bool(false),
        }
    }

    /// `activation(norm(conv(x)))`. Batch norm by running statistics is folded into the convolution.
    pub(crate) fn after(&self, conv: &Conv2d, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        if self.instance {
            return instance_norm(conv.forward(x, Activation::Identity), activation);
        }
        let (Some(weight), Some(bias), Some(mean), Some(variance)) =
            (&self.weight, &self.bias, &self.running_mean, &self.running_var)
        else {
            return conv.forward(x, activation);
        };
        if self.batch_statistics.val().is_enabled() {
            let y = conv.forward(x, Activation::Identity);
            let y = batch_norm(y, weight.val(), bias.val(), activation == Activation::Relu);
            let found = y.running(mean.value(), variance.value());
            for (running, found) in [mean, variance].into_iter().zip(found) {
                running.update(found);
                running.value_sync();
            }
            return match activation {
                Activation::Identity | Activation::Relu => y.output,
                Activation::Gelu => gelu(y.output),
                Activation::Tanh => y.output.tanh(),
                Activation::Sigmoid => sigmoid(y.output),
            };
        }
        let scale = weight.val() / (variance.value() + EPSILON).sqrt();
        let mut shift = bias.val() - mean.value() * scale.clone();
        if let Some(bias) = conv.bias() {
            shift = shift + bias * scale.clone();
        }
        let channels = scale.dims()[0];
        let folded = conv.weight() * scale.reshape([channels, 1, 1, 1]);
        conv.apply(x, folded, &WeightCache::default(), Epilogue::with(activation).bias(Some(shift)))
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;

    use super::*;
    use crate::blocks::Conv2dConfig;

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
    fn batch_norm_trains_as_pytorchs() {
        let device = Device::flex().autodiff();
        let conv = Conv2dConfig::new([2, 3], [1, 1]).init(&device);
        let conv = conv.filled(numbers([3, 2, 1, 1], 1, &device), numbers([3], 2, &device));
        let mut norm = Norm::new(NormKind::Batch, 3, &device);
        norm.weight = Some(Param::from_tensor(numbers([3], 3, &device)));
        norm.bias = Some(Param::from_tensor(numbers([3], 4, &device)));
        let norm = with_batch_statistics(norm, true);
        norm.after(&conv, numbers([2, 2, 3, 4], 5, &device), Activation::Relu);
        let x = numbers([2, 2, 3, 4], 6, &device).require_grad();
        let out = norm.after(&conv, x.clone(), Activation::Relu);
        let at = |x: Tensor<4>| x.narrow(2, 1, 1).narrow(3, 2, 1);
        assert_close("output", at(out.clone()), &OUT);
        let grads = (out * numbers([2, 3, 3, 4], 7, &device)).sum().backward();
        assert_close("running mean", norm.running_mean.as_ref().expect("there").value(), &MEAN);
        assert_close("running variance", norm.running_var.as_ref().expect("there").value(), &VARIANCE);
        assert_close("gradient of x", at(x.grad(&grads).expect("a gradient")), &X_GRADIENT);
        assert_close("of the convolution", conv.weight().grad(&grads).expect("a gradient"), &CONV_GRADIENT);
        let weight = norm.weight.as_ref().expect("there").val();
        assert_close("of the weight", weight.grad(&grads).expect("a gradient"), &WEIGHT_GRADIENT);
    }

    /// The same frames, estimated with the statistics that training gathered.
    #[test]
    fn running_statistics_come_to_those_of_the_batch() {
        let device = Device::flex();
        let conv = Conv2dConfig::new([2, 3], [1, 1]).init(&device);
        let norm = with_batch_statistics(Norm::new(NormKind::Batch, 3, &device), true);
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
