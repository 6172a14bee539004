//! STSTNet (Liong et al., FG 2019): three shallow streams of one convolution each. Reference: `main.py` of
//! christy1206/STSTNet, the authors' own port to PyTorch. Parity: `PARITY.md`.

use burn::module::Module;
use burn::tensor::module::{avg_pool2d, max_pool2d};
use burn::tensor::ops::{AvgPoolOptions, MaxPoolOptions};
use burn::tensor::{Device, Tensor};
use srflow_core::random::Stream;
use srflow_nn::layers::{BatchNorm, Conv2d, Conv2dConfig, Linear, LinearConfig, dropout};
use srflow_ops::Activation;

use super::{Classifier, ClassifierFacts, reduced};
use crate::features::Features;

/// Channels of the three streams.
const STREAMS: [usize; 3] = [3, 5, 8];

#[derive(Module, Debug)]
pub struct StstNet {
    conv1: Conv2d,
    conv2: Conv2d,
    conv3: Conv2d,
    bn1: BatchNorm,
    bn2: BatchNorm,
    bn3: BatchNorm,
    fc: Linear,
}

impl Classifier for StstNet {
    const FACTS: ClassifierFacts = ClassifierFacts {
        name: "ststnet",
        title: "STSTNet",
        paper: "Liong et al., FG 2019",
        reference: "https://github.com/christy1206/STSTNet",
        parameters: 1_683,
        input: "u, v and strain at 28x28",
    };
    const INPUT: [usize; 3] = [3, 28, 28];

    fn new(device: &Device, classes: usize) -> Self {
        let [conv1, conv2, conv3] = STREAMS
            .map(|channels| Conv2dConfig::new([3, channels], [3, 3]).with_padding(Some([2, 2])).init(device));
        let [bn1, bn2, bn3] = STREAMS.map(|channels| BatchNorm::new(channels, device));
        let fc = LinearConfig::new(5 * 5 * STREAMS.iter().sum::<usize>(), classes).init(device);
        Self { conv1, conv2, conv3, bn1, bn2, bn3, fc }
    }

    fn input(features: &Features) -> Vec<f32> {
        reduced::<4>(features, 3)
    }

    fn scores(&self, inputs: Tensor<4>, mut random: Option<&mut Stream>) -> Tensor<2> {
        let streams = [(&self.conv1, &self.bn1), (&self.conv2, &self.bn2), (&self.conv3, &self.bn3)];
        let streams = streams.map(|(conv, norm)| {
            let x = norm.forward(conv.forward(inputs.clone(), Activation::Relu));
            dropout(max_pool2d(x, MaxPoolOptions::new([3, 3]).with_padding([1, 1])), random.as_deref_mut())
        });
        let x = avg_pool2d(Tensor::cat(streams.into(), 1), AvgPoolOptions::new([2, 2]));
        self.fc.forward(x.flatten(1, 3))
    }
}
