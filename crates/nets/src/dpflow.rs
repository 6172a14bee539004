//! DPFlow (Morimitsu et al., CVPR 2025): <https://arxiv.org/abs/2503.14880>. A recurrent encoder computes a feature pyramid, down
//! and up again, with a number of levels that depends on the size of the frames; flow is refined from the coarsest level to the
//! finest. Parity with the reference: `PARITY.md`.

use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig, ConvTranspose2d, ConvTranspose2dConfig};
use srflow_ops::Activation::{self, Gelu, Identity, Relu, Tanh};
use srflow_ops::WeightCache;
use srflow_ops::activation::tensor::activated_sum;
use srflow_ops::concatenate;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::instance_norm::tensor::group_norm;
use srflow_ops::layer_norm::tensor::layer_norm;

use crate::blocks::level::{Depthwise, Level, MOTION, RADIUS, Transition, UpdateBlock};
use crate::blocks::{ConvGru, Grids, resize, resize_flow, upsample_by};
use crate::estimate::{Estimate, LaplaceMixture, Request};
use crate::facts::{Facts, IterationPresets, Padding, Start, ptlflow};
use crate::features::Features;
use crate::frames::{Border, Frames};
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::recurrent::{Refined, STRIDE, refine};
use crate::settings::{Allowed, Setting};

/// Added to the variance by layer norms.
const EPSILON: f64 = 1e-6;
/// Fewest levels of the pyramid.
const FEWEST_LEVELS: usize = 3;
/// Diagonal in pixels from which the reference computes the number of levels.
const DIAGONAL: f64 = 1100.0;
/// Channels of the encoder's stems, at 1/2 and 1/4 of the size.
const STEM: [usize; 2] = [64, 96];
/// Channels of the hidden state and of the context, in encoder and refinement.
const HIDDEN: usize = 128;
/// Channels of a level: the first two thirds are matched, the rest is context.
const FEATURES: usize = 3 * HIDDEN;
/// Blocks of a stage.
const BLOCKS: usize = 4;
/// Initial layer scale of every block.
const LAYER_SCALE: f64 = 1e-2;
/// Alignment for all resizing.
const GRIDS: Grids = Grids::CornersOnCorners;
/// Groups of the encoder's group norms.
const GROUPS: usize = 8;

pub(crate) const DPFLOW: Entry<DpFlow> = Entry {
    facts: Facts {
        name: "dpflow",
        title: "DPFlow",
        paper: "https://arxiv.org/abs/2503.14880",
        parameters: 10_021_508,
        padding: padding(FEWEST_LEVELS),
        smallest_side: 2 * padding(FEWEST_LEVELS),
        iterations: IterationPresets { default: 4, authors: 4, training: 4 },
        start: Start::CoarsestLevel,
        trains: true,
        mixture: true,
        memory: MemoryNeed { fixed: 130_000_000, per_pixel: 750, attending: 0, most_weights: 0 },
        authors: "https://github.com/hmorimitsu/ptlflow",
        licence: "Apache-2.0; weights for research only",
        published: &[
            ptlflow!("dpflow", "chairs", "f94e717a"),
            ptlflow!("dpflow", "things", "2012b5d6"),
            ptlflow!("dpflow", "sintel", "b44b072c"),
            ptlflow!("dpflow", "kitti", "4e97eac6"),
            ptlflow!("dpflow", "spring", "69bac7fa"),
        ],
        ..Facts::DEFAULT
    },
    init: DpFlow::new,
};

#[derive(Module, Debug)]
pub struct DpFlow {
    fnet: Encoder,
    update_block: UpdateBlock<Stage>,
    /// Levels of the pyramid; 0 to choose by the size of the frames.
    levels: usize,
}

/// `CGUBidirDualEncoder`.
#[derive(Module, Debug)]
struct Encoder {
    forward_gru: ConvGru,
    down_gru: Conv2d,
    backward_gru: ConvGru,
    up_gru: ConvTranspose2d,
    stem: Stem,
    lowres_stem: Stem,
    out_1x1: Conv2d,
    rec_stage: Stage,
    back_stage: Stage,
    out_merge_conv: Conv2d,
    out_stages: Stage,
}

/// `ResStem`: reduces the size to 1/4.
#[derive(Module, Debug)]
struct Stem {
    conv1: Conv2d,
    layer1: [Residual; 2],
    layer2: [Residual; 2],
    conv2: Conv2d,
}

/// `ResidualBlock`.
#[derive(Module, Debug)]
struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
    downsample: Option<[Conv2d; 1]>,
}

/// `CGUStage`.
#[derive(Module, Debug)]
struct Stage {
    conv_transition: Option<Transition>,
    blocks: Vec<Unit>,
}

/// `CGU`: gates each map by itself and, if two frames are encoded together, by both maps.
#[derive(Module, Debug)]
struct Unit {
    layer_scale: Param<Tensor<1>>,
    conv_self: Gated,
    conv_cross: Option<CrossGated>,
}

/// `ActGLU`.
#[derive(Module, Debug)]
struct Gated {
    fc1_g: Conv2d,
    fc1_x: Conv2d,
    dwconv_g: Depthwise,
    dwconv_x: Depthwise,
    fc2: Conv2d,
}

/// `CrossActGLU`.
#[derive(Module, Debug)]
struct CrossGated {
    merge_fc_g: Conv2d,
    fc1_g: Conv2d,
    fc1_y: Conv2d,
    dwconv_g: Depthwise,
    dwconv_y: Depthwise,
    fc2: Conv2d,
}

/// The multiple to which frames are padded for this many levels; also the side of a pixel of the coarsest level.
const fn padding(levels: usize) -> usize {
    STRIDE << (levels - 1)
}

/// Number of levels for frames of this height and width (`compute_pyramid_levels`).
fn levels_of([height, width]: [usize; 2]) -> usize {
    let factor = (height as f64).hypot(width as f64) / DIAGONAL;
    FEWEST_LEVELS + factor.max(1.0).log2().round_ties_even() as usize
}

fn norm(x: Tensor<4>, activation: Activation) -> Tensor<4> {
    group_norm(x, GROUPS, EPSILON, activation)
}

fn conv(channels: [usize; 2], kernel: usize, stride: usize, device: &Device) -> Conv2d {
    Conv2dConfig::new(channels, [kernel; 2]).with_stride(stride).init(device)
}

/// Applies `of` to the maps of the first frame, and to those of the second.
fn of_each(
    a: [Tensor<4>; 2],
    b: [Tensor<4>; 2],
    of: impl Fn(Tensor<4>, Tensor<4>) -> Tensor<4>,
) -> [Tensor<4>; 2] {
    let ([a1, a2], [b1, b2]) = (a, b);
    [of(a1, b1), of(a2, b2)]
}

impl DpFlow {
    pub(crate) fn new(device: &Device) -> Self {
        let gate = || Stage::alone([2 * HIDDEN + MOTION, HIDDEN], device);
        Self {
            fnet: Encoder::new(device),
            update_block: UpdateBlock::new(HIDDEN, 1, gate, 2 + 4, device),
            levels: 0,
        }
    }

    fn levels_for(&self, size: [usize; 2]) -> usize {
        if self.levels == 0 { levels_of(size) } else { self.levels }
    }

    /// Adds the flow, in pixels of its level, and its mixture to the estimate, upsampled. The mixture: log weights, then log scales,
    /// `[batch, 4, height, width]`.
    fn push_upsampled(
        &self,
        estimate: &mut Estimate,
        hidden: &Tensor<4>,
        [flow, mixture]: [Tensor<4>; 2],
        padded: [usize; 2],
        border: Border,
    ) {
        let weights = self.update_block.mask.weights(hidden);
        let flow = resize_flow(upsample_by(&weights, flow), padded, GRIDS);
        let part = |first| {
            let coarse = mixture.clone().narrow(1, first, 2) / STRIDE as f64;
            border.remove(resize(upsample_by(&weights, coarse), padded, GRIDS))
        };
        estimate.mixtures.push(LaplaceMixture { log_weights: part(0), log_scales: part(2) });
        estimate.flows.push(border.remove(flow));
    }
}

impl FlowNetwork for DpFlow {
    fn features(&self, frames: Tensor<4>) -> Features {
        let [_, _, height, width] = frames.dims();
        let levels = self.levels_for([height, width]);
        Features::of_prepared(frames, padding(levels), |frames| self.fnet.stems(frames, levels))
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let [batch, _, height, width] = frames.first.dims();
        let levels = self.levels_for([height, width]);
        let (first, second, border) = frames.prepared(padding(levels));
        let [_, _, height, width] = first.dims();
        let device = first.device();
        let stems = request
            .features_of([first, second], Features::into_levels, |frames| self.fnet.stems(frames, levels));
        let coarsest = [height, width].map(|side| side / padding(levels));
        let mut flow = request.start_flow(batch, coarsest, &device);
        let mut estimate = Estimate::of_flows(Vec::new());
        let mut iterations = None;
        for (number, [first, second]) in self.fnet.pyramid(stems).into_iter().enumerate() {
            let [_, _, rows, columns] = first.dims();
            let Level { correlation, context, hidden } = Level::new(first, second);
            flow = resize_flow(flow, [rows, columns], GRIDS);
            let step = |hidden, flow, windows| {
                let [hidden, both] =
                    self.update_block.step(hidden, &context, [flow, windows], Stage::forward);
                Refined { hidden, change: both.clone().narrow(1, 0, 2), further: both.narrow(1, 2, 4) }
            };
            let mut refinement = request.refinement(request.iterations, border);
            let lookup = (&correlation, RADIUS);
            [_, flow] =
                refine(lookup, &mut refinement, [hidden, flow], step, |hidden, flow, mixture, last| {
                    if request.every_iteration || (last && number + 1 == levels) {
                        let found = [flow.clone(), mixture];
                        self.push_upsampled(&mut estimate, hidden, found, [height, width], border);
                    }
                });
            iterations = Some(refinement.done());
        }
        Estimate { coarse: Some(resize_flow(flow, coarsest, GRIDS)), iterations, ..estimate }
    }

    fn padding(&self) -> Option<Padding> {
        Some(match self.levels {
            0 => Padding::BySize(|size| padding(levels_of(size))),
            levels => Padding::Fixed(padding(levels)),
        })
    }

    fn levels(&self, size: [usize; 2]) -> Option<usize> {
        Some(self.levels_for(size))
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![Setting {
            name: "levels",
            description: "levels of the pyramid; 0 for 3 up to a diagonal of 1555 pixels and one more for each doubling, \
                          as in ptlflow",
            allowed: Allowed::OneOf(&[0, 3, 4, 5, 6, 7, 8]),
            in_files: None,
            value: &mut self.levels,
        }]
    }
}

impl Encoder {
    fn new(device: &Device) -> Self {
        let gru = || ConvGru::new(HIDDEN, HIDDEN, device);
        let pointwise = |inputs, outputs| conv([inputs, outputs], 1, 1, device);
        Self {
            forward_gru: gru(),
            down_gru: conv([HIDDEN; 2], 3, 2, device),
            backward_gru: gru(),
            up_gru: ConvTranspose2dConfig::new([HIDDEN; 2], [4, 4])
                .with_stride(2)
                .with_padding([1, 1])
                .init(device),
            stem: Stem::new(2 * HIDDEN, device),
            lowres_stem: Stem::new(HIDDEN, device),
            out_1x1: pointwise(HIDDEN, FEATURES),
            rec_stage: Stage::crossing(2, device),
            back_stage: Stage::crossing(1, device),
            out_merge_conv: pointwise(3 * HIDDEN, HIDDEN),
            out_stages: Stage::crossing(1, device),
        }
    }

    /// Maps of each frame alone: input and hidden state of the first level, then a map of the frame for each level.
    fn stems(&self, frames: Tensor<4>, levels: usize) -> Vec<Tensor<4>> {
        let [_, _, height, width] = frames.dims();
        let mut maps = vec![self.stem.forward(frames.clone())];
        maps.extend((1..=levels).map(|level| {
            self.lowres_stem.forward(resize(frames.clone(), [height >> level, width >> level], GRIDS))
        }));
        maps
    }

    /// The maps of both frames at every level, coarsest first.
    fn pyramid(&self, stems: [Vec<Tensor<4>>; 2]) -> Vec<[Tensor<4>; 2]> {
        let [mut first, mut second] = stems.map(Vec::into_iter);
        let mut next = || Some([first.next()?, second.next()?]);
        let Some(inputs) = next() else { return Vec::new() };
        let alone: Vec<[Tensor<4>; 2]> = std::iter::from_fn(next).collect();

        let mut hidden = inputs.clone().map(|map| map.narrow(1, HIDDEN, HIDDEN).tanh());
        let mut x = inputs.map(|map| map.narrow(1, 0, HIDDEN));
        let mut down = Vec::with_capacity(alone.len());
        for number in 1..=alone.len() {
            hidden = of_each(hidden, x, |hidden, x| self.forward_gru.step(Some(hidden), x));
            x = self.rec_stage.pair(hidden.clone());
            down.push(x.clone());
            if number < alone.len() {
                hidden = hidden.map(|hidden| self.down_gru.forward(hidden, Tanh));
            }
        }

        let mut hidden: Option<[Tensor<4>; 2]> = None;
        let mut levels = Vec::with_capacity(alone.len());
        for (down, alone) in down.into_iter().zip(alone).rev() {
            let state = match hidden {
                Some(hidden) => {
                    let hidden = hidden.map(|hidden| self.up_gru.forward(hidden, Tanh));
                    of_each(hidden, down.clone(), |hidden, x| self.backward_gru.step(Some(hidden), x))
                }
                None => down.clone().map(|x| self.backward_gru.step(None, x)),
            };
            let up = self.back_stage.pair(state.clone());
            let merged = of_each(of_each(down, up, cat), alone, cat);
            let merged = merged.map(|maps| self.out_merge_conv.forward(relu(maps), Identity));
            levels.push(self.out_stages.pair(merged).map(|map| self.out_1x1.forward(map, Identity)));
            hidden = Some(state);
        }
        levels
    }
}

/// Concatenates channels.
fn cat(a: Tensor<4>, b: Tensor<4>) -> Tensor<4> {
    concatenate(vec![a, b])
}

impl Stem {
    fn new(outputs: usize, device: &Device) -> Self {
        let [half, quarter] = STEM;
        Self {
            conv1: conv([3, half], 7, 2, device),
            layer1: [(); 2].map(|()| Residual::new([half, half], 1, device)),
            layer2: [Residual::new([half, quarter], 2, device), Residual::new([quarter, quarter], 1, device)],
            conv2: conv([quarter, outputs], 1, 1, device),
        }
    }

    fn forward(&self, frames: Tensor<4>) -> Tensor<4> {
        let mut x = norm(self.conv1.forward(frames, Identity), Relu);
        for block in self.layer1.iter().chain(&self.layer2) {
            x = block.forward(x);
        }
        self.conv2.forward(x, Identity)
    }
}

impl Residual {
    fn new(channels @ [_, outputs]: [usize; 2], stride: usize, device: &Device) -> Self {
        Self {
            conv1: conv(channels, 3, stride, device),
            conv2: conv([outputs, outputs], 3, 1, device),
            downsample: (stride > 1).then(|| [conv(channels, 1, stride, device)]),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = norm(self.conv1.forward(x.clone(), Identity), Relu);
        let y = norm(self.conv2.forward(y, Identity), Relu);
        let shortcut = match &self.downsample {
            Some([conv]) => norm(conv.forward(x, Identity), Identity),
            None => x,
        };
        activated_sum(shortcut, y, Relu)
    }
}

impl Stage {
    /// A stage for the maps of both frames.
    fn crossing(stride: usize, device: &Device) -> Self {
        let transition = (stride > 1).then(|| Transition { proj: conv([HIDDEN; 2], 3, stride, device) });
        Self { conv_transition: transition, blocks: (0..BLOCKS).map(|_| Unit::new(true, device)).collect() }
    }

    /// A stage for single maps, with other input channels.
    fn alone(channels: [usize; 2], device: &Device) -> Self {
        Self {
            conv_transition: Some(Transition { proj: conv(channels, 1, 1, device) }),
            blocks: (0..BLOCKS).map(|_| Unit::new(false, device)).collect(),
        }
    }

    fn transition(&self, x: Tensor<4>) -> Tensor<4> {
        match &self.conv_transition {
            Some(transition) => transition.proj.forward(x, Identity),
            None => x,
        }
    }

    /// Applies a stage for single maps, then the activation.
    fn forward(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        let x = self.blocks.iter().fold(self.transition(x), |x, block| block.forward(x));
        layer_norm(x, EPSILON, activation)
    }

    /// Applies a stage to the maps of both frames.
    fn pair(&self, maps: [Tensor<4>; 2]) -> [Tensor<4>; 2] {
        let maps = maps.map(|x| self.transition(x));
        self.blocks.iter().fold(maps, |maps, block| block.pair(maps)).map(|x| norm(x, Identity))
    }
}

impl Unit {
    fn new(crossing: bool, device: &Device) -> Self {
        Self {
            layer_scale: Initializer::Constant { value: LAYER_SCALE }.init([HIDDEN], device),
            conv_self: Gated::new(device),
            conv_cross: crossing.then(|| CrossGated::new(device)),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let gated = self.conv_self.gated(layer_norm(x.clone(), EPSILON, Identity));
        self.add_scaled(&self.conv_self.fc2, gated, x)
    }

    fn pair(&self, maps: [Tensor<4>; 2]) -> [Tensor<4>; 2] {
        let Some(cross) = &self.conv_cross else { return maps.map(|x| self.forward(x)) };
        let [x, y] = maps.clone().map(|map| self.conv_self.forward(norm(map, Identity)));
        let [first, second] = maps;
        let first = self.add_scaled(&cross.fc2, cross.gated(x, y.clone()), first);
        let second = self.add_scaled(&cross.fc2, cross.gated(y, first.clone()), second);
        [first, second]
    }

    /// `x + layer_scale * conv(branch)`, with the scale multiplied into the kernel.
    fn add_scaled(&self, conv: &Conv2d, branch: Tensor<4>, x: Tensor<4>) -> Tensor<4> {
        let scale = self.layer_scale.val();
        let kernel = conv.weight() * scale.clone().reshape([HIDDEN, 1, 1, 1]);
        let epilogue = Epilogue::default().bias(conv.bias().map(|bias| bias * scale)).residual(x);
        conv.apply(branch, kernel, &WeightCache::default(), epilogue)
    }
}

impl Gated {
    fn new(device: &Device) -> Self {
        let pointwise = |inputs, outputs| conv([inputs, outputs], 1, 1, device);
        Self {
            fc1_g: pointwise(HIDDEN, 2 * HIDDEN),
            fc1_x: pointwise(HIDDEN, 2 * HIDDEN),
            dwconv_g: depthwise(device),
            dwconv_x: depthwise(device),
            fc2: pointwise(2 * HIDDEN, HIDDEN),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.fc2.forward(self.gated(x), Identity)
    }

    /// The input of the last convolution.
    fn gated(&self, x: Tensor<4>) -> Tensor<4> {
        let gate = self.dwconv_g.dwconv.forward(self.fc1_g.forward(x.clone(), Identity), Gelu);
        gate * self.dwconv_x.dwconv.forward(self.fc1_x.forward(x, Identity), Identity)
    }
}

impl CrossGated {
    fn new(device: &Device) -> Self {
        let pointwise = |inputs, outputs| conv([inputs, outputs], 1, 1, device);
        Self {
            merge_fc_g: pointwise(2 * HIDDEN, HIDDEN),
            fc1_g: pointwise(HIDDEN, 2 * HIDDEN),
            fc1_y: pointwise(HIDDEN, 2 * HIDDEN),
            dwconv_g: depthwise(device),
            dwconv_y: depthwise(device),
            fc2: pointwise(2 * HIDDEN, HIDDEN),
        }
    }

    /// The input of the last convolution.
    fn gated(&self, x: Tensor<4>, y: Tensor<4>) -> Tensor<4> {
        let both = self.merge_fc_g.forward(cat(x, y.clone()), Identity);
        let gate = self.dwconv_g.dwconv.forward(self.fc1_g.forward(both, Identity), Gelu);
        gate * self.dwconv_y.dwconv.forward(self.fc1_y.forward(y, Identity), Identity)
    }
}

fn depthwise(device: &Device) -> Depthwise {
    Depthwise { dwconv: Conv2dConfig::new([2 * HIDDEN; 2], [7, 7]).with_depthwise(true).init(device) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's 1K, 2K, 4K and 8K, and sizes on both sides of a threshold.
    #[test]
    fn the_number_of_levels_matches_the_reference() {
        let levels = [[540, 960], [1080, 1920], [2160, 3840], [4320, 7680]].map(levels_of);
        assert_eq!(levels, [3, 4, 5, 6]);
        assert_eq!([[1, 1], [1099, 1099], [1101, 1101]].map(levels_of), [3, 3, 4]);
        assert_eq!([3, 4, 5].map(padding), [32, 64, 128]);
    }
}
