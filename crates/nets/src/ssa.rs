//! SSA (Alkaddour, Tariq and Dhall, *Self-Supervised Approach for Facial Movement Based Optical Flow*, IEEE Transactions on
//! Affective Computing 2022): <https://arxiv.org/abs/2105.01256>. FlowNetS that encodes both frames alone up to an eighth of the
//! size, and predicts flow up to half the size. Parity with the reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::ops::PadMode;
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, ConvTranspose2d};
use srflow_ops::Activation::{Identity, LeakyRelu, Relu};
use srflow_ops::concatenate;

use crate::blocks::{Grids, resize, resize_flow};
use crate::estimate::{Estimate, Request};
use crate::facts::Facts;
use crate::features::Features;
use crate::flownet::{Initializers, MULTIPLE, padded};
use crate::frames::Frames;
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};

pub(crate) const SSA: Entry<Ssa> = Entry {
    facts: Facts {
        name: "ssa",
        title: "SSA",
        paper: "https://arxiv.org/abs/2105.01256",
        parameters: 49_437_364,
        padding: MULTIPLE,
        trains: true,
        memory: MemoryNeed { fixed: 190_000_000, per_pixel: 660, attending: 0, most_weights: 0 },
        in_ptlflow: false,
        authors: "https://github.com/malkaddour/Self-Supervised-Approach-for-facial-movement-based-optical-flow",
        licence: "none stated",
        renamed: own_name,
        ..Facts::DEFAULT
    },
    init: Ssa::new,
};

/// The network of the paper.
#[derive(Module, Debug)]
pub struct Ssa {
    conv1: Conv2d,
    conv2: Conv2d,
    conv3: Conv2d,
    conv_redir: Conv2d,
    conv3_1: Conv2d,
    conv4: Conv2d,
    conv4_1: Conv2d,
    conv5: Conv2d,
    conv5_1: Conv2d,
    conv6: Conv2d,
    conv6_1: Conv2d,
    deconv5: ConvTranspose2d,
    deconv4: ConvTranspose2d,
    deconv3: ConvTranspose2d,
    deconv2: ConvTranspose2d,
    deconv1: ConvTranspose2d,
    join5: Conv2d,
    join4: Conv2d,
    join3: Conv2d,
    predict6: Conv2d,
    predict5: Conv2d,
    predict4: Conv2d,
    predict3: Conv2d,
    predict2: Conv2d,
    predict1: Conv2d,
}

/// The maps of one frame, of half, a quarter and an eighth of its size.
struct Tower {
    conv1: Tensor<4>,
    conv2: Tensor<4>,
    conv3: Tensor<4>,
}

const INITIALIZERS: Initializers =
    Initializers { weight: Initializer::XavierUniform { gain: 1.0 }, bias: Initializer::Zeros };

impl Tower {
    fn of_features(features: Features) -> Self {
        let [conv1, conv2, conv3] = features.into_maps();
        Self { conv1, conv2, conv3 }
    }
}

impl Ssa {
    /// With random parameters, as training starts.
    pub(crate) fn new(device: &Device) -> Self {
        let conv = |channels, kernel| INITIALIZERS.conv(channels, kernel, 1).init(device);
        // For `halved`, which pads.
        let halving =
            |channels, kernel| INITIALIZERS.conv(channels, kernel, 2).with_padding(Some([0, 0])).init(device);
        let doubling = |channels| INITIALIZERS.deconv(channels).init(device);
        let predict = |channels| conv([channels, 2], 3);
        Self {
            conv1: halving([3, 64], 7),
            conv2: halving([64, 128], 5),
            conv3: halving([128, 256], 5),
            conv_redir: conv([256, 32], 1),
            conv3_1: conv([32 + 2 * 256, 256], 3),
            conv4: halving([256, 512], 3),
            conv4_1: conv([512, 512], 3),
            conv5: halving([512, 512], 3),
            conv5_1: conv([512, 512], 3),
            conv6: halving([512, 1024], 3),
            conv6_1: conv([1024, 1024], 3),
            deconv5: doubling([1024, 512]),
            deconv4: doubling([1024, 512]),
            deconv3: doubling([1024, 256]),
            deconv2: doubling([512, 128]),
            deconv1: doubling([258, 64]),
            join5: conv([512 + 512 + 2, 1024], 1),
            join4: conv([512 + 512 + 2, 1024], 1),
            join3: conv([256 + 256 + 2, 512], 1),
            predict6: predict(1024),
            predict5: predict(1024),
            predict4: predict(1024),
            predict3: predict(512),
            predict2: predict(258),
            predict1: predict(130),
        }
    }

    fn tower(&self, frames: Tensor<4>) -> Tower {
        let conv1 = halved(&self.conv1, prepared(frames));
        let conv2 = halved(&self.conv2, conv1.clone());
        Tower { conv3: halved(&self.conv3, conv2.clone()), conv1, conv2 }
    }

    /// Flows of a 32nd of the size to half the size, each in its own pixels.
    fn flows(&self, first: Tower, second: Tensor<4>) -> Vec<Tensor<4>> {
        let redirected = self.conv_redir.forward(first.conv3.clone(), LeakyRelu);
        let joined = concatenate(vec![redirected, first.conv3, second]);
        let map3 = self.conv3_1.forward(joined, LeakyRelu);
        let map4 = self.conv4_1.forward(halved(&self.conv4, map3.clone()), LeakyRelu);
        let map5 = self.conv5_1.forward(halved(&self.conv5, map4.clone()), LeakyRelu);
        let mut map = self.conv6_1.forward(halved(&self.conv6, map5.clone()), Relu);
        let mut flow = self.predict6.forward(map.clone(), Identity);
        let levels = [
            (map5, &self.deconv5, Some(&self.join5), &self.predict5),
            (map4, &self.deconv4, Some(&self.join4), &self.predict4),
            (map3, &self.deconv3, Some(&self.join3), &self.predict3),
            (first.conv2, &self.deconv2, None, &self.predict2),
            (first.conv1, &self.deconv1, None, &self.predict1),
        ];
        let refined = levels.into_iter().map(|(finer, deconv, join, predict)| {
            let [_, _, height, width] = finer.dims();
            let larger = resize_flow(flow.clone(), [height, width], Grids::FirstOnFirst);
            let joined = concatenate(vec![finer, deconv.forward(map.clone(), LeakyRelu), larger]);
            map = match join {
                Some(join) => join.forward(joined, Relu),
                None => joined,
            };
            flow = predict.forward(map.clone(), Identity);
            flow.clone()
        });
        refined.collect()
    }
}

impl FlowNetwork for Ssa {
    fn features(&self, frames: Tensor<4>) -> Features {
        let batch = frames.dims()[0];
        let Tower { conv1, conv2, conv3 } = self.tower(frames);
        Features::new(batch, vec![conv1, conv2, conv3])
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let size = frames.size();
        // The finer maps of the second frame are not needed: they are dropped here.
        let [first, Tower { conv3: second, .. }] =
            request
                .features_of([frames.first, frames.second], Tower::of_features, |frames| self.tower(frames));
        let mut flows = self.flows(first, second);
        if !request.every_iteration {
            flows.drain(..flows.len() - 1);
        }
        let finished = |flow| resize_flow(flow, size, Grids::EdgesOnEdges);
        Estimate::of_flows(flows.into_iter().map(finished).collect())
    }
}

/// Frames in 0..255, resized to multiples of [`MULTIPLE`].
fn prepared(frames: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = frames.dims();
    resize(frames * 255.0, padded([height, width]), Grids::EdgesOnEdges)
}

/// A convolution of stride 2 with TensorFlow's padding `same`: for even sizes one more row and column after than before.
fn halved(conv: &Conv2d, x: Tensor<4>) -> Tensor<4> {
    let zeros = conv.weight().dims()[2] - 2;
    let (before, after) = (zeros / 2, zeros - zeros / 2);
    conv.forward(x.pad((before, after, before, after), PadMode::Constant(0.0)), LeakyRelu)
}

/// From the names of the authors' layers. Those without a name are numbered by Keras.
fn own_name(name: &str) -> Option<String> {
    let (layer, parameter) = name.rsplit_once('.')?;
    let layer = match layer {
        "conv2d_1" => "conv6_1",
        "conv2d_2" => "join5",
        "conv2d_3" => "join4",
        "conv2d_4" => "join3",
        "Deconv6_prediction" => "predict6",
        "Deconv5_prediction" => "predict5",
        "Deconv4_prediction" => "predict4",
        "Deconv3_prediction" => "predict3",
        "Deconv2_prediction" => "predict2",
        "Deconv1_prediction" => "predict1",
        other => other,
    };
    Some(format!("{layer}.{parameter}"))
}

#[cfg(test)]
mod tests {
    use srflow_nn::parameter_infos;

    use super::*;

    #[test]
    fn names_of_keras_layers_are_known() {
        let names: Vec<String> =
            parameter_infos(&Ssa::new(&Device::flex())).into_iter().map(|info| info.name).collect();
        for theirs in ["conv1.weight", "conv2d_1.bias", "conv2d_4.weight", "Deconv1_prediction.bias"] {
            let ours = own_name(theirs).expect("a parameter");
            assert!(names.contains(&ours), "{theirs}: {ours}");
        }
        assert!(names.iter().all(|name| own_name(name).as_ref() == Some(name)), "its own names stay");
    }
}
