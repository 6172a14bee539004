//! FlowNetS and FlowNetC (Dosovitskiy et al., *FlowNet*, ICCV 2015: <https://arxiv.org/abs/1504.06852>) with the weights of
//! FlowNet 2.0 (Ilg et al., CVPR 2017: <https://arxiv.org/abs/1612.01925>), which stacks them. Encoders down to 1/64 of the size,
//! and a decoder that predicts flow at 1/64 to 1/4 of it. Parity with the reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig, ConvTranspose2d, ConvTranspose2dConfig, NoParameters};
use srflow_ops::Activation::{self, Identity, LeakyRelu};
use srflow_ops::concatenate;
use srflow_ops::correlation::tensor::Correlation;

use crate::blocks::{Grids, resize, resize_flow};
use crate::estimate::{Estimate, Request};
use crate::facts::{Facts, Start, ptlflow};
use crate::features::Features;
use crate::frames::Frames;
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::recurrent::pixel_grid;

/// Height and width of frames are resized to multiples of this.
pub(crate) const MULTIPLE: usize = 64;
/// Pixels per unit of the network's flow.
pub(crate) const FLOW_SCALE: f64 = 20.0;
/// Displacements of FlowNetC's correlation to each side.
const REACH: usize = 10;
/// Pixels between displacements.
const SPACING: usize = 2;
/// Channels of the correlation.
pub(crate) const CORRELATED: usize = (2 * REACH + 1) * (2 * REACH + 1);

pub(crate) const FLOWNETS: Entry<FlowNet> = Entry {
    facts: Facts {
        name: "flownets",
        title: "FlowNetS",
        paper: "https://arxiv.org/abs/1504.06852",
        parameters: 38_676_506,
        padding: MULTIPLE,
        start: Start::Frames("FlowNet computes flow from the frames alone"),
        trains: true,
        memory: MemoryNeed { fixed: 180_000_000, per_pixel: 234, attending: 0, most_weights: 0 },
        authors: "https://github.com/NVIDIA/flownet2-pytorch",
        licence: "Apache-2.0, weights for research only",
        published: &[ptlflow!("flownets", "things", "98cde14d")],
        ..Facts::DEFAULT
    },
    init: |device| FlowNet::new(Kind::Simple { channels: 6 }, device),
};

pub(crate) const FLOWNETC: Entry<FlowNet> = Entry {
    facts: Facts {
        name: "flownetc",
        title: "FlowNetC",
        parameters: 39_175_298,
        memory: MemoryNeed { fixed: 185_000_000, per_pixel: 322, attending: 0, most_weights: 0 },
        published: &[ptlflow!("flownetc", "things", "cc8ac7fd")],
        ..FLOWNETS.facts
    },
    init: |device| FlowNet::new(Kind::Correlating, device),
};

/// A convolution and its activation.
type Conv = (Conv2d, NoParameters);
/// A transposed convolution and its activation.
type Deconv = (ConvTranspose2d, NoParameters);

/// FlowNetS or FlowNetC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// FlowNetS with this many input channels.
    Simple { channels: usize },
    /// FlowNetC, which encodes two images separately.
    Correlating,
}

/// FlowNetS or FlowNetC.
#[derive(Module, Debug)]
pub struct FlowNet {
    conv1: Conv,
    conv2: Conv,
    conv3: Conv,
    conv_redir: Option<Conv>,
    conv3_1: Conv,
    conv4: Conv,
    conv4_1: Conv,
    conv5: Conv,
    conv5_1: Conv,
    conv6: Conv,
    conv6_1: Conv,
    deconv5: Deconv,
    deconv4: Deconv,
    deconv3: Deconv,
    deconv2: Deconv,
    predict_flow6: Conv2d,
    predict_flow5: Conv2d,
    predict_flow4: Conv2d,
    predict_flow3: Conv2d,
    predict_flow2: Conv2d,
    upsampled_flow6_to_5: ConvTranspose2d,
    upsampled_flow5_to_4: ConvTranspose2d,
    upsampled_flow4_to_3: ConvTranspose2d,
    upsampled_flow3_to_2: ConvTranspose2d,
}

/// Feature maps that FlowNetC computes from a single image.
#[derive(Debug, Clone)]
pub(crate) struct Tower {
    /// 1/4 of the size.
    pub(crate) conv2: Tensor<4>,
    /// 1/8 of the size.
    pub(crate) conv3: Tensor<4>,
}

/// Initializers of the layers of a network.
pub(crate) struct Initializers {
    pub(crate) weight: Initializer,
    pub(crate) bias: Initializer,
}

const INITIALIZERS: Initializers = Initializers {
    weight: Initializer::XavierUniform { gain: 1.0 },
    bias: Initializer::Uniform { min: 0.0, max: 1.0 },
};

impl Initializers {
    pub(crate) fn conv(&self, channels: [usize; 2], kernel: usize, stride: usize) -> Conv2dConfig {
        Conv2dConfig::new(channels, [kernel; 2])
            .with_stride(stride)
            .with_initializer(self.weight.clone())
            .with_bias_initializer(self.bias.clone())
    }

    /// Doubles the size.
    pub(crate) fn deconv(&self, channels: [usize; 2]) -> ConvTranspose2dConfig {
        ConvTranspose2dConfig::new(channels, [4, 4])
            .with_stride(2)
            .with_padding([1, 1])
            .with_initializer(self.weight.clone())
            .with_bias_initializer(self.bias.clone())
    }
}

impl FlowNet {
    pub(crate) fn new(kind: Kind, device: &Device) -> Self {
        let activated = |channels, kernel, stride| {
            (INITIALIZERS.conv(channels, kernel, stride).init(device), NoParameters)
        };
        let doubled = |channels| (INITIALIZERS.deconv(channels).init(device), NoParameters);
        let predicted = |channels| INITIALIZERS.conv([channels, 2], 3, 1).init(device);
        let correlating = kind == Kind::Correlating;
        let (images, correlated) = match kind {
            Kind::Simple { channels } => (channels, 256),
            Kind::Correlating => (3, 32 + CORRELATED),
        };
        let upsampled = || INITIALIZERS.deconv([2, 2]).with_bias(correlating).init(device);
        Self {
            conv1: activated([images, 64], 7, 2),
            conv2: activated([64, 128], 5, 2),
            conv3: activated([128, 256], 5, 2),
            conv_redir: correlating.then(|| activated([256, 32], 1, 1)),
            conv3_1: activated([correlated, 256], 3, 1),
            conv4: activated([256, 512], 3, 2),
            conv4_1: activated([512, 512], 3, 1),
            conv5: activated([512, 512], 3, 2),
            conv5_1: activated([512, 512], 3, 1),
            conv6: activated([512, 1024], 3, 2),
            conv6_1: activated([1024, 1024], 3, 1),
            deconv5: doubled([1024, 512]),
            deconv4: doubled([1026, 256]),
            deconv3: doubled([770, 128]),
            deconv2: doubled([386, 64]),
            predict_flow6: predicted(1024),
            predict_flow5: predicted(1026),
            predict_flow4: predicted(770),
            predict_flow3: predicted(386),
            predict_flow2: predicted(194),
            upsampled_flow6_to_5: upsampled(),
            upsampled_flow5_to_4: upsampled(),
            upsampled_flow4_to_3: upsampled(),
            upsampled_flow3_to_2: upsampled(),
        }
    }

    /// The first layers, applied to an image (FlowNetC) or to the whole input (FlowNetS).
    pub(crate) fn tower(&self, x: Tensor<4>) -> Tower {
        let conv2 = self.conv2.0.forward(self.conv1.0.forward(x, LeakyRelu), LeakyRelu);
        Tower { conv3: self.conv3.0.forward(conv2.clone(), LeakyRelu), conv2 }
    }

    /// FlowNetS: five flows at 1/64 to 1/4 of the size, coarsest first.
    pub(crate) fn simple(&self, x: Tensor<4>) -> Vec<Tensor<4>> {
        let Tower { conv2, conv3 } = self.tower(x);
        self.refined(conv2, self.conv3_1.0.forward(conv3, LeakyRelu))
    }

    /// FlowNetC: five flows as in [`simple`](Self::simple).
    pub(crate) fn correlating(&self, first: Tower, second: Tensor<4>) -> Vec<Tensor<4>> {
        let correlation = leaky_relu(correlation(first.conv3.clone(), second), f64::from(Activation::LEAK));
        let redirected = self.conv_redir.as_ref().map(|conv| conv.0.forward(first.conv3, LeakyRelu));
        let joined = concatenate(redirected.into_iter().chain([correlation]).collect());
        self.refined(first.conv2, self.conv3_1.0.forward(joined, LeakyRelu))
    }

    fn refined(&self, map2: Tensor<4>, map3: Tensor<4>) -> Vec<Tensor<4>> {
        let halved = |x: &Tensor<4>, first: &Conv, second: &Conv| {
            second.0.forward(first.0.forward(x.clone(), LeakyRelu), LeakyRelu)
        };
        let map4 = halved(&map3, &self.conv4, &self.conv4_1);
        let map5 = halved(&map4, &self.conv5, &self.conv5_1);
        let mut map = halved(&map5, &self.conv6, &self.conv6_1);
        let mut flow = self.predict_flow6.forward(map.clone(), Identity);
        let mut flows = vec![flow.clone()];
        for (finer, deconv, upsampled, predict) in [
            (map5, &self.deconv5, &self.upsampled_flow6_to_5, &self.predict_flow5),
            (map4, &self.deconv4, &self.upsampled_flow5_to_4, &self.predict_flow4),
            (map3, &self.deconv3, &self.upsampled_flow4_to_3, &self.predict_flow3),
            (map2, &self.deconv2, &self.upsampled_flow3_to_2, &self.predict_flow2),
        ] {
            let coarser = deconv.0.forward(map, LeakyRelu);
            map = concatenate(vec![finer, coarser, upsampled.forward(flow, Identity)]);
            flow = predict.forward(map.clone(), Identity);
            flows.push(flow.clone());
        }
        flows
    }
}

impl FlowNetwork for FlowNet {
    fn features(&self, frames: Tensor<4>) -> Features {
        let batch = frames.dims()[0];
        if self.conv_redir.is_none() {
            return Features::new(batch, Vec::new());
        }
        self.tower(prepared(frames)).into_features(batch)
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let size = frames.size();
        let flows = if self.conv_redir.is_none() {
            self.simple(concatenate(vec![prepared(frames.first), prepared(frames.second)]))
        } else {
            let [first, second] = towers(self, frames, request);
            self.correlating(first, second.conv3)
        };
        estimate(flows, size, request)
    }
}

impl Tower {
    pub(crate) fn into_features(self, frames: usize) -> Features {
        Features::new(frames, vec![self.conv2, self.conv3])
    }

    pub(crate) fn of_features(features: Features) -> Self {
        let [conv2, conv3] = features.into_maps();
        Self { conv2, conv3 }
    }
}

/// Towers of both frames, taken from the request if it has them.
pub(crate) fn towers(network: &FlowNet, frames: Frames, request: &Request) -> [Tower; 2] {
    request.features_of([frames.first, frames.second], Tower::of_features, |frames| {
        network.tower(prepared(frames))
    })
}

/// Subtracts the mean colour of each frame, and resizes to multiples of [`MULTIPLE`].
pub(crate) fn prepared(frames: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = frames.dims();
    let mean = frames.clone().mean_dim(3).mean_dim(2);
    resize(frames - mean, padded([height, width]), Grids::CornersOnCorners)
}

/// The size that frames are resized to.
pub(crate) fn padded(size: [usize; 2]) -> [usize; 2] {
    size.map(|side| side.next_multiple_of(MULTIPLE))
}

/// The requested flows, resized to the frames, from those of the last network, coarsest first.
pub(crate) fn estimate(mut flows: Vec<Tensor<4>>, size: [usize; 2], request: &Request) -> Estimate {
    let resized = padded(size);
    if !request.every_iteration {
        flows.drain(..flows.len() - 1);
    }
    let finished = |flow| resize_flow(full_size(flow, resized), size, Grids::CornersOnCorners);
    Estimate::of_flows(flows.into_iter().map(finished).collect())
}

/// Resizes a flow of the network to height and width `size`, and scales it to pixels.
pub(crate) fn full_size(flow: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    resize(flow, size, Grids::EdgesOnEdges) * FLOW_SCALE
}

/// Correlation of each pixel of the first map with a 21x21 window of every second pixel of the other around it, averaged over
/// channels: `[batch, CORRELATED, height, width]`, zero outside of the map. Height and width must be even.
///
/// Pixels are only compared with pixels of the same parity of row and column, so the maps are split by parity.
pub(crate) fn correlation(first: Tensor<4>, second: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = first.dims();
    let [rows, columns] = [height / SPACING, width / SPACING];
    let by_parity =
        |map: Tensor<4>| {
            map.reshape([batch, channels, rows, SPACING, columns, SPACING])
                .permute([0, 3, 5, 1, 2, 4])
                .reshape([batch * SPACING * SPACING, channels, rows, columns])
        };
    let grid = pixel_grid([batch * SPACING * SPACING, rows, columns], &first.device());
    let windows = Correlation::new(by_parity(first), by_parity(second), 1).windows(grid, REACH);
    let side = 2 * REACH + 1;
    // The lookup orders a window column by column, the network row by row.
    let ordered = windows
        .reshape([batch, SPACING, SPACING, side, side, rows, columns])
        .permute([0, 4, 3, 5, 1, 6, 2])
        .reshape([batch, CORRELATED, height, width]);
    // The lookup divides by the square root of the number of channels, the network by the number itself.
    ordered / (channels as f64).sqrt()
}
