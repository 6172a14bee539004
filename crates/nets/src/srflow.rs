//! The network of srflow's own: small and fast, for the small motions of faces. Flow is estimated from coarse to fine by matching
//! learned features, as in PWC-Net (Sun et al. 2018), then refined at half of the size by a U-Net, repeatedly with shared weights and
//! with frame 2 warped, as in RAFT; uncertainty is SEA-RAFT's. Each step also sees, and starts from, what the method of Lucas and
//! Kanade finds between the frames at that size: where brightness determines the motion, nothing needs to be learned.
//! `tools/parity/srflow_net.py` is the same in PyTorch.

use burn::module::{Initializer, Module};
use burn::tensor::module::avg_pool2d;
use burn::tensor::ops::AvgPoolOptions;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig};
use srflow_ops::Activation::{Identity, LeakyRelu};
use srflow_ops::correlation::tensor::Correlation;
use srflow_ops::lucas_kanade::tensor::lucas_kanade;
use srflow_ops::lucas_kanade::{CELL, LucasKanade, PER_WINDOW};
use srflow_ops::space_to_depth::tensor::space_to_depth;
use srflow_ops::upsample::tensor::convex_upsample;
use srflow_ops::warp::tensor::warp_replicated;

use crate::MemoryNeed;
use crate::blocks::{Grids, resize, resize_flow};
use crate::estimate::{Estimate, LaplaceMixture, Request};
use crate::facts::{Facts, IterationPresets};
use crate::features::Features;
use crate::frames::{Border, Frames, prepared};
use crate::recurrent::pixel_grid;
use crate::table::{Entry, FlowNetwork};

/// Channels of the feature maps from 1/2 to 1/16 of the size.
const CHANNELS: [usize; 4] = [24, 48, 64, 64];
/// Pixels of the frame per pixel of the maps that are matched, along each axis.
const STRIDES: [usize; 3] = [4, 8, 16];
const COARSEST_STRIDE: usize = STRIDES[2];
/// Radius of the search at each of them: together they reach about 120 px.
const RADII: [usize; 3] = [3, 3, 4];
/// Channels within a matching.
const MATCHING: usize = 64;
/// Channels that a matching or refinement hands to the next one.
const STATE: usize = 32;
/// Of the flow: its change; logarithms of the weights and of the scales of two Laplace distributions.
const OUTPUTS: usize = 2 + 2 + 2;
/// Pixels of the frame per pixel of the map that is refined, along each axis.
const STRIDE: usize = 2;
/// Channels of the refinement at 1/2, 1/4 and 1/8 of the size.
const WIDTHS: [usize; 3] = [32, 64, 96];
/// Channels of what a refinement sees: the pixels of frame 1 and of the warped frame 2 in each cell, the evidence, the flow and
/// the state.
const SEEN: usize = 2 * 3 * STRIDE * STRIDE + LucasKanade::OUTPUTS + 2 + STATE;
/// Scale of the difference of the frames, which is small where the flow is nearly right.
const DIFFERENCE_SCALE: f64 = 4.0;
/// What brightness says about the remaining motion. The noise is the square of about 1.5 of 255 levels.
const EVIDENCE: LucasKanade = LucasKanade { radii: [1, 3], noise: 1.4e-4, reach: 2.0 };

pub(crate) const SRFLOW: Entry<SrFlow> = Entry {
    facts: Facts {
        name: "srflow",
        title: "srflow",
        parameters: 1_079_764,
        padding: COARSEST_STRIDE,
        smallest_side: 2 * COARSEST_STRIDE,
        iterations: IterationPresets { default: 2, authors: 2, training: 2 },
        trains: true,
        mixture: true,
        memory: MemoryNeed { fixed: 275_000_000, per_pixel: 335, attending: 0, most_weights: 0 },
        in_ptlflow: false,
        licence: "MIT OR Apache-2.0",
        ..Facts::DEFAULT
    },
    init: SrFlow::new,
};

#[derive(Module, Debug)]
pub struct SrFlow {
    /// From the frame to 1/16 of the size.
    pyramid: Vec<Step>,
    /// At 1/4, 1/8 and 1/16 of the size.
    matchings: Vec<Matching>,
    refinement: Refinement,
    /// Weights of the 9 coarse neighbours of each of the 4 pixels.
    mask: Conv2d,
}

/// Halves the size.
#[derive(Module, Debug)]
struct Step {
    down: Conv2d,
    same: Conv2d,
}

/// Estimates how far the flow of a level is off, from the correlation of both frames' features around it.
#[derive(Module, Debug)]
struct Matching {
    conv1: Conv2d,
    conv2: Conv2d,
    conv3: Conv2d,
    predict: Conv2d,
}

/// Estimates how far the flow is off from the pixels of frame 1 and the warped frame 2: a U-Net down to 1/8 of the size.
#[derive(Module, Debug)]
struct Refinement {
    enter: Conv2d,
    down: Vec<Step>,
    /// From 1/4 to 1/2 of the size.
    up: Vec<Conv2d>,
    state: Conv2d,
    predict: Conv2d,
}

/// The estimate at a level.
struct Found {
    /// In pixels of the level.
    flow: Tensor<4>,
    mixture: Tensor<4>,
    state: Tensor<4>,
}

fn conv(inputs: usize, outputs: usize, stride: usize, device: &Device) -> Conv2d {
    Conv2dConfig::new([inputs, outputs], [3, 3]).with_stride(stride).init(device)
}

/// At first nothing is added to the evidence: untrained, the network is the coarse-to-fine method of Lucas and Kanade.
fn prediction(device: &Device) -> Conv2d {
    Conv2dConfig::new([STATE, OUTPUTS], [3, 3])
        .with_initializer(Initializer::Zeros)
        .with_bias_initializer(Initializer::Zeros)
        .init(device)
}

impl Step {
    fn new(inputs: usize, outputs: usize, device: &Device) -> Self {
        Self { down: conv(inputs, outputs, 2, device), same: conv(outputs, outputs, 1, device) }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.same.forward(self.down.forward(x, LeakyRelu), LeakyRelu)
    }
}

impl SrFlow {
    fn new(device: &Device) -> Self {
        let step = |level: usize| {
            let inputs = if level == 0 { 3 } else { CHANNELS[level - 1] };
            Step::new(inputs, CHANNELS[level], device)
        };
        Self {
            pyramid: (0..CHANNELS.len()).map(step).collect(),
            matchings: (0..STRIDES.len()).map(|level| Matching::new(level, device)).collect(),
            refinement: Refinement::new(device),
            mask: conv(STATE, 9 * STRIDE * STRIDE, 1, device),
        }
    }

    /// Feature maps at 1/4, 1/8 and 1/16 of the size.
    fn maps(&self, frames: Tensor<4>) -> Vec<Tensor<4>> {
        let mut x = frames;
        let mut maps = Vec::with_capacity(self.pyramid.len());
        for step in &self.pyramid {
            x = step.forward(x);
            maps.push(x.clone());
        }
        maps.split_off(1)
    }
}

impl Matching {
    fn new(level: usize, device: &Device) -> Self {
        // Windows, features and their difference, evidence, flow, state.
        let side = 2 * RADII[level] + 1;
        let inputs = side * side + 2 * CHANNELS[level + 1] + LucasKanade::OUTPUTS + 2 + STATE;
        Self {
            conv1: conv(inputs, MATCHING, 1, device),
            conv2: conv(MATCHING, MATCHING, 1, device),
            conv3: conv(MATCHING, STATE, 1, device),
            predict: prediction(device),
        }
    }

    /// The change of `found`, and the next state. `frames` have cells of the size of the maps' pixels.
    fn forward(
        &self,
        radius: usize,
        frames: [&Tensor<4>; 2],
        [first, second]: [&Tensor<4>; 2],
        found: Found,
    ) -> Found {
        let Found { flow, state, .. } = found;
        let [batch, _, height, width] = first.dims();
        let grid = pixel_grid([batch, height, width], &first.device());
        let windows = Correlation::new(first.clone(), second.clone(), 1).windows(grid + flow.clone(), radius);
        let difference = first.clone() - warp_replicated(second.clone(), flow.clone());
        let (_, evidence) = evidence(frames, &flow);
        let seen = vec![windows, first.clone(), difference, evidence.clone(), flow.clone(), state];
        let x = self.conv1.forward(Tensor::cat(seen, 1), LeakyRelu);
        let state = self.conv3.forward(self.conv2.forward(x, LeakyRelu), LeakyRelu);
        Found::new(flow, evidence, self.predict.forward(state.clone(), Identity), state)
    }
}

impl Refinement {
    fn new(device: &Device) -> Self {
        let [fine, middle, coarse] = WIDTHS;
        Self {
            enter: conv(SEEN, fine, 1, device),
            down: vec![Step::new(fine, middle, device), Step::new(middle, coarse, device)],
            up: vec![conv(coarse + middle, middle, 1, device), conv(middle + fine, fine, 1, device)],
            state: conv(fine, STATE, 1, device),
            predict: prediction(device),
        }
    }

    /// The change of `found`, and the next state.
    fn forward(&self, frames: [&Tensor<4>; 2], found: Found) -> Found {
        let Found { flow, state, .. } = found;
        let (warped, evidence) = evidence(frames, &flow);
        let first = frames[0].clone();
        let cells = |frames| space_to_depth(frames, STRIDE);
        let difference = (first.clone() - warped) * DIFFERENCE_SCALE;
        let seen = vec![cells(first), cells(difference), evidence.clone(), flow.clone(), state];
        let fine = self.enter.forward(Tensor::cat(seen, 1), LeakyRelu);
        let middle = self.down[0].forward(fine.clone());
        let coarse = self.down[1].forward(middle.clone());
        let middle = self.up[0].forward(Tensor::cat(vec![twice(coarse), middle], 1), LeakyRelu);
        let fine = self.up[1].forward(Tensor::cat(vec![twice(middle), fine], 1), LeakyRelu);
        let state = self.state.forward(fine, LeakyRelu);
        Found::new(flow, evidence, self.predict.forward(state.clone(), Identity), state)
    }
}

/// Frame 2 warped by `flow`, which is in pixels of cells, and what remains of the motion.
fn evidence([first, second]: [&Tensor<4>; 2], flow: &Tensor<4>) -> (Tensor<4>, Tensor<4>) {
    let [_, _, height, width] = first.dims();
    let flow = resize_flow(flow.clone(), [height, width], Grids::EdgesOnEdges);
    let warped = warp_replicated(second.clone(), flow);
    let evidence = lucas_kanade(EVIDENCE, first.clone(), warped.clone());
    (warped, evidence)
}

impl Found {
    fn new(start: Tensor<4>, evidence: Tensor<4>, predicted: Tensor<4>, state: Tensor<4>) -> Self {
        let of_evidence = evidence.narrow(1, PER_WINDOW, 2) / CELL as f64;
        let flow = start + of_evidence + predicted.clone().narrow(1, 0, 2);
        Self { flow, mixture: predicted.narrow(1, 2, OUTPUTS - 2), state }
    }
}

/// `x` at twice the size.
fn twice(x: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = x.dims();
    resize(x, [2 * height, 2 * width], Grids::EdgesOnEdges)
}

impl FlowNetwork for SrFlow {
    fn features(&self, frames: Tensor<4>) -> Features {
        let [batch, _, height, width] = frames.dims();
        let frames = prepared(frames, Border::new([height, width], COARSEST_STRIDE));
        Features::new(batch, self.maps(frames))
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        assert!(request.iterations > 0, "at least one iteration");
        let (first, second, border) = frames.prepared(COARSEST_STRIDE);
        let [batch, _, height, width] = first.dims();
        let device = first.device();
        let maps = [first.clone(), second.clone()];
        let [firsts, seconds] = request.features_of(maps, Features::into_levels, |frames| self.maps(frames));
        let coarsest = [height / COARSEST_STRIDE, width / COARSEST_STRIDE];
        let zeros = |channels| Tensor::zeros([batch, channels, coarsest[0], coarsest[1]], &device);
        let mut found = Found { flow: zeros(2), mixture: zeros(OUTPUTS - 2), state: zeros(STATE) };
        let mut estimate = Estimate::of_flows(Vec::new());
        let mut add = |flow: Tensor<4>, mixture: &Tensor<4>| {
            let mixture = border.remove(resize(mixture.clone(), [height, width], Grids::EdgesOnEdges));
            let part = |from| mixture.clone().narrow(1, from, 2);
            estimate.flows.push(border.remove(flow));
            estimate.mixtures.push(LaplaceMixture { log_weights: part(0), log_scales: part(2) });
        };
        // Both frames at half, a quarter and an eighth of the size.
        let smaller = [first.clone(), second.clone()].map(|frames| smaller(frames, STRIDES.len()));
        for level in (0..STRIDES.len()).rev() {
            let frames = [&smaller[0][level], &smaller[1][level]];
            let maps = [&firsts[level], &seconds[level]];
            found = self.matchings[level].forward(RADII[level], frames, maps, found);
            let size = [2 * height / STRIDES[level], 2 * width / STRIDES[level]];
            if request.every_iteration {
                add(resize_flow(found.flow.clone(), [height, width], Grids::EdgesOnEdges), &found.mixture);
            }
            // Each matching and refinement learns by its own prediction, as in RAFT.
            let flow = resize_flow(found.flow.detach(), size, Grids::EdgesOnEdges);
            found = Found { flow, state: twice(found.state), ..found };
        }
        for iteration in 1..=request.iterations {
            found = self.refinement.forward([&first, &second], found);
            if request.every_iteration || iteration == request.iterations {
                let weights = self.mask.forward(found.state.clone(), Identity);
                add(convex_upsample(found.flow.clone(), weights, 1.0, STRIDE), &found.mixture);
            }
            found.flow = found.flow.detach();
        }
        estimate
    }
}

/// Frames at half of the size, a quarter and so on.
fn smaller(frames: Tensor<4>, levels: usize) -> Vec<Tensor<4>> {
    let half = |frames: &Tensor<4>| Some(avg_pool2d(frames.clone(), AvgPoolOptions::new([2, 2])));
    std::iter::successors(half(&frames), half).take(levels).collect()
}
