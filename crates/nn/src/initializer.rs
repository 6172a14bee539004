//! Random parameters of new networks.

use burn::config::Config;
use burn::module::{Param, ParamId};
use burn::tensor::{Device, Distribution, Tensor, TensorData};

/// What the values of a new parameter are, by the names of `torch.nn.init`.
#[derive(Config, Debug, PartialEq)]
pub enum Initializer {
    Zeros,
    Ones,
    Constant {
        value: f64,
    },
    /// These, row by row.
    Values {
        values: Vec<f32>,
    },
    Uniform {
        min: f64,
        max: f64,
    },
    Normal {
        mean: f64,
        std: f64,
    },
    /// Uniform with a standard deviation of `gain / sqrt(fan)`; the fan is that of the inputs, or of the outputs.
    KaimingUniform {
        gain: f64,
        fan_out_only: bool,
    },
    /// Normal with a standard deviation of `gain / sqrt(fan)`.
    KaimingNormal {
        gain: f64,
        fan_out_only: bool,
    },
    /// Uniform with a standard deviation of `gain sqrt(2 / (fan_in + fan_out))`.
    XavierUniform {
        gain: f64,
    },
}

impl Initializer {
    /// A parameter whose values are drawn when it is first read.
    pub fn init<const D: usize>(&self, shape: [usize; D], device: &Device) -> Param<Tensor<D>> {
        self.init_with(shape, fans(&shape), device)
    }

    /// The bias of a layer whose weight has a shape, from whose fans it is drawn.
    pub fn init_bias(&self, channels: usize, weight: &[usize], device: &Device) -> Param<Tensor<1>> {
        self.init_with([channels], fans(weight), device)
    }

    fn init_with<const D: usize>(
        &self,
        shape: [usize; D],
        fans: [usize; 2],
        device: &Device,
    ) -> Param<Tensor<D>> {
        let initializer = self.clone();
        let draw = move |device: &Device, require_grad: bool| {
            let tensor = initializer.draw(shape, fans, device);
            if require_grad { tensor.require_grad() } else { tensor }
        };
        Param::uninitialized(ParamId::new(), draw, device.clone(), true, shape.into())
    }

    fn draw<const D: usize>(&self, shape: [usize; D], fans: [usize; 2], device: &Device) -> Tensor<D> {
        let kaiming = |fan_out_only: bool| 1.0 / (fans[usize::from(fan_out_only)] as f64).sqrt();
        let xavier = (2.0 / (fans[0] + fans[1]) as f64).sqrt();
        let normal = |mean, std| Tensor::random(shape, Distribution::Normal(mean, std), device);
        let uniform = |min, max| Tensor::random(shape, Distribution::Uniform(min, max), device);
        let within = |gain: f64, std: f64| {
            let most = 3.0_f64.sqrt() * gain * std;
            uniform(-most, most)
        };
        match *self {
            Self::Values { ref values } => Tensor::from_data(TensorData::new(values.clone(), shape), device),
            Self::Zeros => Tensor::zeros(shape, device),
            Self::Ones => Tensor::ones(shape, device),
            Self::Constant { value } => Tensor::full(shape, value, device),
            Self::Uniform { min, max } => uniform(min, max),
            Self::Normal { mean, std } => normal(mean, std),
            Self::KaimingUniform { gain, fan_out_only } => within(gain, kaiming(fan_out_only)),
            Self::KaimingNormal { gain, fan_out_only } => normal(0.0, gain * kaiming(fan_out_only)),
            Self::XavierUniform { gain } => within(gain, xavier),
        }
    }
}

/// Fan-in and fan-out of a weight, as `_calculate_fan_in_and_fan_out` of PyTorch has them: the second axis and the first, times the taps.
fn fans(shape: &[usize]) -> [usize; 2] {
    let axis = |axis: usize| shape.get(axis).copied().unwrap_or(1);
    let taps: usize = shape.iter().skip(2).product();
    [axis(1) * taps, axis(0) * taps]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean, standard deviation and largest magnitude of a weight of 64 outputs, 32 inputs and 3x3 taps.
    fn statistics(initializer: &Initializer) -> [f64; 3] {
        let weight = initializer.init::<4>([64, 32, 3, 3], &Device::flex()).val();
        let numbers: Vec<f64> =
            weight.into_data().try_to_vec::<f32>().expect("f32").into_iter().map(f64::from).collect();
        let count = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / count;
        let variance = numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count;
        [mean, variance.sqrt(), numbers.iter().fold(0.0, |most: f64, x| most.max(x.abs()))]
    }

    #[test]
    fn weights_have_the_deviation_that_pytorch_gives_them() {
        let (fan_in, fan_out) = (32.0 * 9.0, 64.0 * 9.0);
        let cases = [
            (Initializer::KaimingUniform { gain: 2.0, fan_out_only: false }, 2.0 / f64::sqrt(fan_in), true),
            (Initializer::KaimingNormal { gain: 2.0, fan_out_only: true }, 2.0 / f64::sqrt(fan_out), false),
            (Initializer::XavierUniform { gain: 0.5 }, 0.5 * f64::sqrt(2.0 / (fan_in + fan_out)), true),
            (Initializer::Normal { mean: 0.0, std: 0.1 }, 0.1, false),
            (Initializer::Uniform { min: -3.0, max: 3.0 }, 3.0_f64.sqrt(), true),
        ];
        for (initializer, std, uniform) in cases {
            let [mean, found, largest] = statistics(&initializer);
            assert!(mean.abs() < 0.05 * std, "{initializer}: {mean}");
            assert!((found / std - 1.0).abs() < 0.03, "{initializer}: {found} for {std}");
            let within = largest <= 3.0_f64.sqrt() * std * 1.000_001;
            assert_eq!(within, uniform, "{initializer}: {largest}");
        }
        assert_eq!(statistics(&Initializer::Constant { value: -2.0 }), [-2.0, 0.0, 2.0]);
    }

    #[test]
    fn a_bias_is_drawn_by_the_fans_of_its_weight() {
        let within = Initializer::KaimingUniform { gain: 1.0 / 3.0_f64.sqrt(), fan_out_only: false };
        let bias = within.init_bias(1000, &[1000, 5, 2, 2], &Device::flex()).val();
        let numbers = bias.into_data().try_to_vec::<f32>().expect("f32");
        let largest = numbers.into_iter().fold(0.0_f32, |most, x| most.max(x.abs()));
        let limit = 1.0 / 20.0_f32.sqrt();
        assert!(largest <= limit && largest > 0.98 * limit, "{largest} for {limit}");
    }
}
