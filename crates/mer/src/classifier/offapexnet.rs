//! Off-ApexNet (Gan et al., Signal Processing: Image Communication 2019): one stream for each direction of the flow, no
//! strain. Reference: `models/off_apexnet.py` of ECNU-Cross-Innovation-Lab/PRICAI2021-Off-TANet. Parity: `PARITY.md`.

use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use srflow_core::random::Stream as RandomStream;
use srflow_nn::layers::{Conv2d, Conv2dConfig, Linear, LinearConfig, NoParameters, dropout};
use srflow_ops::Activation;
use srflow_ops::max_pool::tensor::max_pool;

use super::{Classifier, ClassifierFacts, reduced};
use crate::features::Features;

#[derive(Module, Debug)]
pub struct OffApexNet {
    cnn1: Stream,
    cnn2: Stream,
    dense: (Linear, NoParameters, NoParameters, Linear, NoParameters, NoParameters, Linear),
}

#[derive(Module, Debug)]
struct Stream {
    conv1: Conv2d,
    conv2: Conv2d,
}

impl Classifier for OffApexNet {
    const FACTS: ClassifierFacts = ClassifierFacts {
        name: "off-apexnet",
        title: "Off-ApexNet",
        paper: "Gan et al., Signal Processing: Image Communication 2019",
        reference: "https://github.com/ECNU-Cross-Innovation-Lab/PRICAI2021-Off-TANet",
        parameters: 2_664_475,
        input: "u and v at 28x28",
    };
    const INPUT: [usize; 3] = [2, 28, 28];

    fn new(device: &Device, classes: usize) -> Self {
        let conv = |channels| Conv2dConfig::new(channels, [5, 5]).init(device);
        let stream = || Stream { conv1: conv([1, 6]), conv2: conv([6, 16]) };
        let linear = |inputs, outputs| LinearConfig::new(inputs, outputs).init(device);
        Self {
            cnn1: stream(),
            cnn2: stream(),
            dense: (
                linear(2 * 16 * 7 * 7, 1024),
                NoParameters,
                NoParameters,
                linear(1024, 1024),
                NoParameters,
                NoParameters,
                linear(1024, classes),
            ),
        }
    }

    fn input(features: &Features) -> Vec<f32> {
        reduced::<4>(features, 2)
    }

    fn scores(&self, inputs: Tensor<4>, mut random: Option<&mut RandomStream>) -> Tensor<2> {
        let [u, v] = [0, 1].map(|channel| inputs.clone().narrow(1, channel, 1));
        let x = Tensor::cat(vec![self.cnn1.forward(u), self.cnn2.forward(v)], 1);
        let x = dropout(relu(self.dense.0.forward(x)), random.as_deref_mut());
        let x = dropout(relu(self.dense.3.forward(x)), random);
        self.dense.6.forward(x)
    }
}

impl Stream {
    /// `[batch, 784]`. The reference has no activation between its convolutions.
    fn forward(&self, x: Tensor<4>) -> Tensor<2> {
        let x = max_pool(self.conv1.forward(x, Activation::Identity));
        max_pool(self.conv2.forward(x, Activation::Identity)).flatten(1, 3)
    }
}
