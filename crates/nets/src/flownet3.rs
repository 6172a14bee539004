//! FlowNet3's stack of three small networks, `css` (Ilg, Saikia, Keuper and Brox, *Occlusions, Motion and Depth Boundaries with a
//! Generic Network for Disparity, Optical Flow or Scene Flow*, ECCV 2018): <https://arxiv.org/abs/1808.01838>. FlowNetC followed by
//! two FlowNetS, each of which corrects flow and occlusions of the previous network. Parity with the reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::activation::{relu, softmax};
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, ConvTranspose2d};
use srflow_ops::Activation::{Identity, LeakyRelu};
use srflow_ops::concatenate;
use srflow_ops::warp::tensor::warp_replicated;

use crate::blocks::{Grids, resize, resize_flow_smoothed, resize_smoothed};
use crate::estimate::{Estimate, Request};
use crate::facts::Facts;
use crate::features::Features;
use crate::flownet::{CORRELATED, Initializers, MULTIPLE, Tower, correlation, padded};
use crate::frames::Frames;
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::recurrent::pixel_grid;

/// Subtracted from every channel of the frames.
const MEAN: f64 = 0.4;
/// Width of the networks in eighths of FlowNet's channels.
const EIGHTHS: usize = 3;
/// Scale of the flow in the input of the second and third network.
const INPUT_FLOW_SCALE: f64 = 0.05;
/// Input channels of the second and third network: both images, the flow, the warped second image, and the probabilities that a
/// pixel is visible and occluded.
const INPUT_CHANNELS: usize = 3 + 3 + 2 + 3 + 2;

pub(crate) const FLOWNET3_CSS: Entry<FlowNet3> = Entry {
    facts: Facts {
        name: "flownet3-css",
        title: "FlowNet3 (css)",
        paper: "https://arxiv.org/abs/1808.01838",
        parameters: 16_847_368,
        padding: MULTIPLE,
        trains: true,
        occlusion: true,
        memory: MemoryNeed { fixed: 340_000_000, per_pixel: 382, attending: 0, most_weights: 0 },
        in_ptlflow: false,
        authors: "https://github.com/lmb-freiburg/netdef_models",
        licence: "GPL-3.0",
        renamed: own_name,
        ..Facts::DEFAULT
    },
    init: FlowNet3::new,
};

#[derive(Module, Debug)]
pub struct FlowNet3 {
    net1: Net,
    net2: Net,
    net3: Net,
}

/// FlowNetC or FlowNetS.
#[derive(Module, Debug)]
struct Net {
    features: Lower,
    encoder: Encoder,
    decoder: Decoder,
}

/// Reduces the size to 1/8.
#[derive(Module, Debug)]
struct Lower {
    conv1: Conv2d,
    conv2: Conv2d,
    conv3: Conv2d,
}

/// Reduces the size from 1/8 to 1/64, and predicts there.
#[derive(Module, Debug)]
struct Encoder {
    conv_redir: Option<Conv2d>,
    conv3_1: Conv2d,
    conv4: Conv2d,
    conv4_1: Conv2d,
    conv5: Conv2d,
    conv5_1: Conv2d,
    conv6: Conv2d,
    conv6_1: Conv2d,
    predict: Conv2d,
}

/// Increases the size to 1/4, or to full size.
#[derive(Module, Debug)]
struct Decoder {
    refine_5: Refine,
    refine_4: Refine,
    refine_3: Refine,
    refine_2: Refine,
    refine_1: Option<Refine>,
    refine_0: Option<Refine>,
    conv_edges: Option<Conv2d>,
}

/// Doubles the size.
#[derive(Module, Debug)]
struct Refine {
    deconv: ConvTranspose2d,
    predict: Conv2d,
}

/// Position of a network in the stack.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    /// Correlates two images.
    First,
    Second,
    /// Predicts at full size, and also predicts motion boundaries.
    Last,
}

/// Feature maps at 1/2, 1/4 and 1/8 of the size.
struct Maps {
    conv1: Tensor<4>,
    tower: Tower,
}

/// Flow in pixels of the resized frames, and logits of each pixel being visible and occluded: `[batch, 2, ...]` each.
#[derive(Clone)]
struct Prediction {
    flow: Tensor<4>,
    occlusion: Tensor<4>,
}

const INITIALIZERS: Initializers = Initializers {
    weight: Initializer::KaimingNormal { gain: std::f64::consts::SQRT_2, fan_out_only: false },
    bias: Initializer::Zeros,
};

/// Scales a number of channels of FlowNet.
const fn part(channels: usize) -> usize {
    channels * EIGHTHS / 8
}

impl Role {
    /// Output channels: flow and occlusion, and motion boundaries.
    fn predicted(self) -> usize {
        if self == Self::Last { 6 } else { 4 }
    }
}

impl FlowNet3 {
    pub(crate) fn new(device: &Device) -> Self {
        Self {
            net1: Net::new(Role::First, device),
            net2: Net::new(Role::Second, device),
            net3: Net::new(Role::Last, device),
        }
    }
}

impl Net {
    fn new(role: Role, device: &Device) -> Self {
        let correlating = role == Role::First;
        let conv = |[inputs, outputs]: [usize; 2], kernel, stride| {
            INITIALIZERS.conv([part(inputs), part(outputs)], kernel, stride).init(device)
        };
        let predict = |inputs| INITIALIZERS.conv([inputs, role.predicted()], 3, 1).init(device);
        let inner = |channels, stride| conv(channels, 3, stride);
        let images = if correlating { 3 } else { INPUT_CHANNELS };
        let redirected = if correlating { part(32) + CORRELATED } else { part(256) };
        let from_images = |images, outputs, kernel, stride| {
            INITIALIZERS.conv([images, part(outputs)], kernel, stride).init(device)
        };
        let mut below = part(1024);
        let mut refine = |features: usize, width: usize| {
            let joined = part(features) + part(width) + role.predicted();
            let deconv = INITIALIZERS.deconv([below, part(width)]).init(device);
            below = joined;
            Refine { deconv, predict: predict(joined) }
        };
        let full_size = role == Role::Last;
        Self {
            features: Lower {
                conv1: from_images(images, 64, 7, 2),
                conv2: conv([64, 128], 5, 2),
                conv3: conv([128, 256], 5, 2),
            },
            encoder: Encoder {
                conv_redir: correlating.then(|| conv([256, 32], 1, 1)),
                conv3_1: from_images(redirected, 256, 3, 1),
                conv4: inner([256, 512], 2),
                conv4_1: inner([512, 512], 1),
                conv5: inner([512, 512], 2),
                conv5_1: inner([512, 512], 1),
                conv6: inner([512, 1024], 2),
                conv6_1: inner([1024, 1024], 1),
                predict: predict(part(1024)),
            },
            decoder: Decoder {
                refine_5: refine(512, 512),
                refine_4: refine(512, 256),
                refine_3: refine(256, 128),
                refine_2: refine(128, 64),
                refine_1: full_size.then(|| refine(64, 32)),
                refine_0: full_size.then(|| refine(16, 16)),
                conv_edges: full_size.then(|| from_images(3, 16, 3, 1)),
            },
        }
    }

    fn lower(&self, x: Tensor<4>) -> Maps {
        let Lower { conv1, conv2, conv3 } = &self.features;
        let conv1 = conv1.forward(x, LeakyRelu);
        let conv2 = conv2.forward(conv1.clone(), LeakyRelu);
        let conv3 = conv3.forward(conv2.clone(), LeakyRelu);
        Maps { conv1, tower: Tower { conv2, conv3 } }
    }

    /// FlowNetC: five predictions at 1/64 to 1/4 of the size, coarsest first.
    fn correlating(&self, first: Tower, second: Tensor<4>) -> Vec<Prediction> {
        let Tower { conv2, conv3 } = first;
        let correlation = relu(correlation(conv3.clone(), second));
        let redirected = self.encoder.conv_redir.as_ref().map(|conv| conv.forward(conv3, LeakyRelu));
        let joined = concatenate(redirected.into_iter().chain([correlation]).collect());
        self.predictions(joined, vec![conv2])
    }

    /// FlowNetS: predictions at 1/64 to 1/4 of the size, coarsest first; the last network also predicts at 1/2 and full size, for
    /// which it uses `image`.
    fn simple(&self, x: Tensor<4>, image: &Tensor<4>) -> Vec<Prediction> {
        let Maps { conv1, tower } = self.lower(x);
        let edges = self.decoder.conv_edges.as_ref().map(|conv| conv.forward(image.clone(), LeakyRelu));
        self.predictions(tower.conv3, [tower.conv2, conv1].into_iter().chain(edges).collect())
    }

    /// Predictions from a map at 1/8 of the size and the finer maps, from 1/4 on.
    fn predictions(&self, x: Tensor<4>, finer: Vec<Tensor<4>>) -> Vec<Prediction> {
        let Self { encoder, decoder, .. } = self;
        let halved = |x: &Tensor<4>, first: &Conv2d, second: &Conv2d| {
            second.forward(first.forward(x.clone(), LeakyRelu), LeakyRelu)
        };
        let map3 = encoder.conv3_1.forward(x, LeakyRelu);
        let map4 = halved(&map3, &encoder.conv4, &encoder.conv4_1);
        let map5 = halved(&map4, &encoder.conv5, &encoder.conv5_1);
        let mut map = halved(&map5, &encoder.conv6, &encoder.conv6_1);
        let mut prediction = encoder.predict.forward(map.clone(), Identity);
        let mut predictions = vec![Prediction::of_channels(&prediction)];
        let Decoder { refine_5, refine_4, refine_3, refine_2, refine_1, refine_0, .. } = decoder;
        let refines = [refine_5, refine_4, refine_3, refine_2].into_iter().chain(refine_1).chain(refine_0);
        for (refine, finer) in refines.zip([map5, map4, map3].into_iter().chain(finer)) {
            let coarser = refine.deconv.forward(map, LeakyRelu);
            let upsampled = resized_constant(prediction, &coarser);
            map = concatenate(vec![finer, coarser, upsampled]);
            prediction = refine.predict.forward(map.clone(), Identity);
            predictions.push(Prediction::of_channels(&prediction));
        }
        predictions
    }
}

impl Prediction {
    fn of_channels(channels: &Tensor<4>) -> Self {
        Self { flow: channels.clone().narrow(1, 0, 2), occlusion: channels.clone().narrow(1, 2, 2) }
    }
}

impl FlowNet3 {
    fn towers(&self, frames: Frames, request: &Request) -> [Tower; 2] {
        request.features_of([frames.first, frames.second], Tower::of_features, |frames| {
            self.net1.lower(prepared(frames)).tower
        })
    }
}

impl FlowNetwork for FlowNet3 {
    fn features(&self, frames: Tensor<4>) -> Features {
        let batch = frames.dims()[0];
        self.net1.lower(prepared(frames)).tower.into_features(batch)
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let size = frames.size();
        let [first, second] = self.towers(frames.clone(), request);
        let mut found = self.net1.correlating(first, second.conv3);
        let [first, second] = [frames.first, frames.second].map(prepared);
        let resized = padded(size);
        let mut flows = Vec::new();
        for net in [&self.net2, &self.net3] {
            let Some(finest) = found.pop() else { break };
            if request.every_iteration {
                flows.extend(found.drain(..).map(|found| found.flow));
                flows.push(finest.flow.clone());
            }
            let flow = resize(finest.flow.clone(), resized, Grids::FirstOnFirst);
            let visibility = softmax(resized_constant(finest.occlusion, &first), 1);
            let input = concatenate(vec![
                first.clone(),
                second.clone(),
                flow.clone() * INPUT_FLOW_SCALE,
                warped(second.clone(), flow),
                visibility.clone(),
            ]);
            let mut corrections = net.simple(input, &first);
            if !request.every_iteration {
                corrections.drain(..corrections.len() - 1);
            }
            let corrected = |by: Prediction| Prediction {
                flow: resized_constant(finest.flow.clone(), &by.flow) + by.flow,
                occlusion: resized_constant(visibility.clone(), &by.occlusion) + by.occlusion,
            };
            found = corrections.into_iter().map(corrected).collect();
        }
        let occlusion = found.last().map(|last| {
            let scores = resize_smoothed(last.occlusion.clone(), size);
            softmax(scores, 1).narrow(1, 1, 1)
        });
        flows.extend(found.into_iter().map(|found| found.flow));
        let finished = |flow| {
            let full = resize(flow, resized, Grids::EdgesOnEdges);
            resize_flow_smoothed(full, size)
        };
        Estimate { occlusion, ..Estimate::of_flows(flows.into_iter().map(finished).collect()) }
    }
}

fn prepared(frames: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = frames.dims();
    resize(frames - MEAN, padded([height, width]), Grids::EdgesOnEdges)
}

/// Resizes `x` to the size of another map and detaches it, as in the reference.
fn resized_constant(x: Tensor<4>, like: &Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = like.dims();
    resize(x, [height, width], Grids::EdgesOnEdges).detach()
}

/// Samples `image` at each pixel displaced by `flow`; zero outside of the image, which extends by one pixel beyond the last row and
/// column.
fn warped(image: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let [batch, _, height, width] = flow.dims();
    let target = pixel_grid([batch, height, width], &flow.device()) + flow.clone();
    let inside = |component: usize, size: usize| {
        let target = target.clone().narrow(1, component, 1);
        target.clone().greater_equal_elem(0.0).float() * target.lower_elem(size as f64).float()
    };
    warp_replicated(image, flow) * inside(0, width) * inside(1, height)
}

/// Maps names of the authors' program, in which FlowNetC's encoder is nested one level deeper than FlowNetS's, and only FlowNetC has
/// a separate module for the first maps.
fn own_name(name: &str) -> Option<String> {
    let mut name = name.replace(".upper.", ".").replace("predict.conv.", "predict.");
    for map in ["conv1", "conv2", "conv3"] {
        name = name.replace(&format!(".encoder.{map}."), &format!(".features.{map}."));
    }
    Some(name)
}

#[cfg(test)]
mod tests {
    use srflow_nn::parameter_infos;
    use srflow_ops::golden::numbers;

    use super::*;

    /// Names of the authors' checkpoint, with dots instead of slashes.
    #[test]
    fn the_authors_names_are_mapped() {
        let network = FlowNet3::new(&Device::flex());
        let names: Vec<String> = parameter_infos(&network).into_iter().map(|info| info.name).collect();
        for theirs in [
            "net1.features.conv1.weight",
            "net1.upper.encoder.conv_redir.bias",
            "net1.upper.encoder.predict.conv.weight",
            "net1.upper.decoder.refine_5.deconv.weight",
            "net2.encoder.conv1.weight",
            "net2.encoder.conv3_1.bias",
            "net3.decoder.refine_0.predict.conv.bias",
            "net3.decoder.conv_edges.weight",
        ] {
            let ours = own_name(theirs).expect("a parameter");
            assert!(names.contains(&ours), "{theirs}: {ours}");
        }
        assert!(
            names.iter().all(|name| own_name(name).as_ref() == Some(name)),
            "its own names stay unchanged"
        );
    }

    #[test]
    fn warping_extends_the_last_column_by_a_pixel() {
        let device = Device::flex();
        let image = Tensor::<1>::from_floats([1.0, 2.0, 4.0], &device).reshape([1, 1, 1, 3]);
        let at = |u: [f32; 3]| {
            let u = Tensor::<1>::from_floats(u, &device).reshape([1, 1, 1, 3]);
            numbers(warped(image.clone(), Tensor::cat(vec![u.clone(), u.zeros_like()], 1)))
        };
        assert_eq!(at([0.0, 0.5, 0.0]), [1.0, 3.0, 4.0]);
        assert_eq!(at([2.5, 1.75, 0.9]), [4.0, 4.0, 4.0]);
        assert_eq!(at([-0.1, 2.0, 1.0]), [0.0, 0.0, 0.0]);
    }
}
