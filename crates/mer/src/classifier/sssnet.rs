//! SSSNet (Varanka et al., Electronic Imaging 2021): a shallow single stream of two convolutions. Reference: `meb/models/me_networks.py`
//! of tvaranka/meb. Parity: `PARITY.md`.

use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::module::max_pool2d;
use burn::tensor::ops::MaxPoolOptions;
use burn::tensor::{Device, Tensor};
use srflow_core::Size;
use srflow_core::random::Stream;
use srflow_core::resize::shrink_area;
use srflow_nn::layers::{BatchNorm, Conv2d, Conv2dConfig, Linear, LinearConfig, dropout};
use srflow_ops::Activation;

use super::{Classifier, ClassifierFacts};
use crate::features::{Channel, Features};

/// Width and height of its input.
const SIDE: usize = 64;
/// Channels after each convolution, and values before the last layer.
const CHANNELS: [usize; 2] = [32, 64];
const HIDDEN: usize = 256;

#[derive(Module, Debug)]
pub struct SssNet {
    conv1: Conv2d,
    bn1: BatchNorm,
    conv2: Conv2d,
    bn2: BatchNorm,
    fc1: Linear,
    fc: Linear,
}

impl Classifier for SssNet {
    const FACTS: ClassifierFacts = ClassifierFacts {
        name: "sssnet",
        title: "SSSNet",
        paper: "Varanka et al., Electronic Imaging 2021",
        reference: "https://github.com/tvaranka/meb",
        parameters: 1_349_251,
        input: "u, v and strain at 64x64",
    };
    const INPUT: [usize; 3] = [3, SIDE, SIDE];

    fn new(device: &Device, classes: usize) -> Self {
        let [first, second] = CHANNELS;
        let unpadded =
            |channels, side| Conv2dConfig::new(channels, [side; 2]).with_padding(Some([0; 2])).init(device);
        Self {
            conv1: unpadded([3, first], 5),
            bn1: BatchNorm::new(first, device),
            conv2: unpadded([first, second], 3),
            bn2: BatchNorm::new(second, device),
            fc1: LinearConfig::new(9 * 9 * second, HIDDEN).init(device),
            fc: LinearConfig::new(HIDDEN, classes).init(device),
        }
    }

    fn input(features: &Features) -> Vec<f32> {
        let shrunk = |channel| shrink_area(&features.plane(channel), Size::new(SIDE, SIDE), 1.0);
        [Channel::U, Channel::V, Channel::Strain]
            .map(shrunk)
            .iter()
            .flat_map(|map| map.pixels())
            .copied()
            .collect()
    }

    fn scores(&self, inputs: Tensor<4>, mut random: Option<&mut Stream>) -> Tensor<2> {
        let pooled = |conv: &Conv2d, norm: &BatchNorm, x, side| {
            norm.forward(max_pool2d(conv.forward(x, Activation::Relu), MaxPoolOptions::new([side; 2])))
        };
        let x = without_maps(pooled(&self.conv1, &self.bn1, inputs, 3), random.as_deref_mut());
        let x = without_maps(pooled(&self.conv2, &self.bn2, x, 2), random.as_deref_mut());
        let x = relu(self.fc1.forward(x.flatten(1, 3)));
        self.fc.forward(dropout(x, random))
    }
}

/// Drops whole maps, as PyTorch's `Dropout2d`.
fn without_maps(x: Tensor<4>, random: Option<&mut Stream>) -> Tensor<4> {
    let [batch, channels, ..] = x.dims();
    match random {
        None => x,
        Some(random) => dropout(Tensor::ones([batch, channels, 1, 1], &x.device()), Some(random)) * x,
    }
}
