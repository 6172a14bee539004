//! Parameters and frames that `tools/parity/nets.py` makes up by the same rules.

use burn::tensor::{Device, Tensor, TensorData};
use srflow_nets::Network;
use srflow_nn::{Parameters, parameter_infos, with_parameters};
use srflow_ops::golden::{Golden, name_hash, noise};

/// Weights with variance 1 / fan_in, which preserves the scale of activations; other parameters near typical trained values.
fn parameter(name: &str, shape: &[usize], gains: &[(String, f32)]) -> Vec<f32> {
    let count: usize = shape.iter().product();
    let seed = name_hash(name);
    let last = name.rsplit('.').next().unwrap_or_default();
    let fan_in: usize = shape[1..].iter().product();
    let gains: Vec<f32> =
        gains.iter().filter(|(part, _)| name.contains(part)).map(|(_, gain)| *gain).collect();
    (0..count as u32)
        .map(|i| {
            let u = gains.iter().fold(noise(i, seed), |u, gain| u * gain);
            match last {
                "running_var" => return 1.0 + 0.5 * u,
                "gamma" => return 0.5 + 0.25 * u,
                "weight" if shape.len() == 1 => return 1.0 + 0.25 * u,
                _ => {}
            }
            if last == "weight" { u * (3.0 / fan_in as f64).sqrt() as f32 } else { 0.1 * u }
        })
        .collect()
}

/// The network with parameters made up by the settings and gains of a golden file.
pub fn filled(mut network: Network, golden: &Golden) -> Network {
    for key in golden.names() {
        if let Some(name) = key.strip_prefix("setting/") {
            network.set(name, golden.values(key)[0] as usize).expect(key);
        }
    }
    let gain = |key: &str| Some((key.strip_prefix("gain/")?.to_owned(), golden.values(key)[0]));
    let gains: Vec<(String, f32)> = golden.names().filter_map(gain).collect();
    let parameters: Parameters = parameter_infos(&network)
        .into_iter()
        .map(|info| {
            let values = parameter(&info.name, &info.shape, &gains);
            (info.name, TensorData::new(values, info.shape))
        })
        .collect();
    with_parameters(network, parameters).expect("its own names and shapes")
}

/// A triangle wave over the integers, in 0..1.
fn wave(n: i64, period: i64) -> f64 {
    (n.rem_euclid(2 * period) - period).abs() as f64 / period as f64
}

/// Three waves and some noise, moved by `shift` pixels to the right and half of it down.
pub fn frame([batch, height, width]: [usize; 3], shift: i64, device: &Device) -> Tensor<4> {
    let mut values = Vec::with_capacity(batch * 3 * height * width);
    for (n, c) in (0..batch as i64).flat_map(|n| (0..3).map(move |c| (n, c))) {
        for (y, x) in (0..height as i64).flat_map(|y| (0..width as i64).map(move |x| (y, x))) {
            let (x, y) = (x - shift + 64, y - shift / 2 + 64);
            let grain = noise(((x + 331 * y + 7919 * c + 104_729 * n) % (1 << 18)) as u32, 5);
            let value = 0.25 * wave(x + 2 * y + 5 * c, 13) + 0.25 * wave(3 * x - y + 1000 + 17 * n, 19);
            values.push((value + 0.3 * wave(x * y / 8 + 3 * c, 29) + 0.1 + 0.1 * f64::from(grain)) as f32);
        }
    }
    Tensor::from_data(TensorData::new(values, [batch, 3, height, width]), device)
}
