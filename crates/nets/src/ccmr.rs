//! CCMR and CCMR+ (Jahedi et al., WACV 2024): coarse-to-fine refinement, where at each level the channels of motion features attend
//! to each other with weights from the context. Parity with the reference: `PARITY.md`.

use std::ops::Range;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::Conv2d;
use srflow_ops::Activation::{self, Identity, Relu, Tanh};
use srflow_ops::WeightCache;
use srflow_ops::concatenate;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::correlation::tensor::Correlation;

use crate::blocks::{
    Attending, Block, ConvexMask, CrossCovariance, Divided, EncoderConfig, FlowHead, Grids, MotionEncoder,
    Norm, NormKind, SepConvGru, Strips, convex_mask_by, convex_upsample_of_strips, encoder_conv, resize,
    resize_flow,
};
use crate::estimate::{Estimate, Request};
use crate::facts::{Facts, IterationPresets, Start, ptlflow};
use crate::features::Features;
use crate::frames::Frames;
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::raft::{HIDDEN, RADIUS};
use crate::recurrent::pixel_grid;
use crate::settings::{Allowed, Setting};

/// Side of a pixel of the coarsest level in pixels of the frame.
const COARSEST_STRIDE: usize = 16;
/// Height and width of frames are padded to multiples of this.
const PADDING: usize = 2 * COARSEST_STRIDE;
/// Upsampling factor between levels.
const FACTOR: usize = 2;
/// Channels of the encoders at 1/2, 1/4, 1/8 and 1/16 of the size.
const WIDTHS: [usize; 4] = [64, 96, 128, 160];
/// Channels that are enlarged together.
const PART: usize = 64;
/// Levels of the correlation pyramid at each level of the network.
const CORRELATION_LEVELS: usize = 2;
/// Channels of the context, and of the attention outputs.
const CONTEXT: usize = HIDDEN;
/// Rows to each side that the motion features of a row depend on: kernels of 7, 3 and 3.
const MOTION_REACH: usize = 5;
/// Rows to each side that a change of the flow depends on: kernels of 3 and 3 before the gates, 5 and 5 of these, 3 and 3.
const REFINEMENT_REACH: usize = 8;
/// Iterations of CCMR at each level, coarsest first, in ptlflow and in the authors' evaluation on Sintel.
const ITERATIONS: [usize; 3] = [8, 10, 15];
/// Iterations of CCMR+, likewise.
const ITERATIONS_PLUS: [usize; 4] = [8, 10, 10, 10];

pub(crate) const CCMR: Entry<Ccmr> = Entry {
    facts: Facts {
        name: "ccmr",
        title: "CCMR",
        paper: "https://openaccess.thecvf.com/content/WACV2024/papers/Jahedi_CCMR_High_Resolution_Optical_Flow_Estimation_via_Coarse-To-Fine_Context-Guided_Motion_WACV_2024_paper.pdf",
        parameters: 10_780_884,
        padding: PADDING,
        smallest_side: 2 * PADDING,
        iterations: IterationPresets { default: 15, authors: 15, training: 8 },
        start: Start::Coarse(COARSEST_STRIDE),
        trains: true,
        memory: MemoryNeed { fixed: 460_000_000, per_pixel: 720, attending: 0, most_weights: 0 },
        authors: "https://github.com/cv-stuttgart/CCMR",
        licence: "BSD-3-Clause, not for military use; weights CC BY-NC-SA 3.0",
        published: &[ptlflow!("ccmr", "sintel", "e1760f37"), ptlflow!("ccmr", "kitti", "612444b9")],
        ..Facts::DEFAULT
    },
    init: |device| Ccmr::new(&ITERATIONS, device),
};

pub(crate) const CCMR_P: Entry<Ccmr> = Entry {
    facts: Facts {
        name: "ccmr-p",
        title: "CCMR+",
        parameters: 11_523_620,
        iterations: IterationPresets { default: 10, authors: 10, training: 6 },
        memory: MemoryNeed { fixed: 1_850_000_000, per_pixel: 780, attending: 0, most_weights: 0 },
        published: &[ptlflow!("ccmr+", "sintel", "055b44ec"), ptlflow!("ccmr+", "kitti", "c289d5e6")],
        ..CCMR.facts
    },
    init: |device| Ccmr::new(&ITERATIONS_PLUS, device),
};

/// CCMR (three levels) or CCMR+ (four).
#[derive(Module, Debug)]
pub struct Ccmr {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
    xcit: Vec<CrossCovariance>,
    /// Number of levels at which flow is refined, from the coarsest on.
    levels: usize,
    /// Rows of strips; by default as many as their memory allows.
    strip_rows: Option<usize>,
}

/// `BasicEncoder_resconv` and `Basic_Context_Encoder_resconv`: down to 1/16 of the size, and up again.
#[derive(Module, Debug)]
struct Encoder {
    conv1: Conv2d,
    norm1: Norm,
    layer1: Vec<Block>,
    layer2: Vec<Block>,
    layer3: Vec<Block>,
    layer4: Vec<Block>,
    conv2: Conv2d,
    up_layer2: Vec<Block>,
    after_up_layer2_conv: Conv2d,
    up_layer1: Vec<Block>,
    after_up_layer1_conv: Conv2d,
    up_layer0: Option<Vec<Block>>,
    after_up_layer0_conv: Option<Conv2d>,
}

/// `BasicUpdateBlock`.
#[derive(Module, Debug)]
struct UpdateBlock {
    encoder: MotionEncoder,
    gru: SepConvGru,
    flow_head: FlowHead,
    mask: ConvexMask,
    aggregator: Vec<CrossCovariance>,
}

impl Ccmr {
    /// A network with as many levels as `iterations`.
    fn new(iterations: &[usize], device: &Device) -> Self {
        let levels = iterations.len();
        let entries = CORRELATION_LEVELS * (2 * RADIUS + 1) * (2 * RADIUS + 1);
        Self {
            fnet: Encoder::new(levels, None, device),
            cnet: Encoder::new(levels, Some(HIDDEN + CONTEXT), device),
            update_block: UpdateBlock {
                encoder: MotionEncoder::of_entries(entries, device),
                gru: SepConvGru::new(HIDDEN, 3 * CONTEXT, device),
                flow_head: FlowHead::new(HIDDEN, 256, device),
                mask: convex_mask_by(FACTOR, HIDDEN, device),
                aggregator: (0..levels).map(|_| CrossCovariance::of_values(CONTEXT, device)).collect(),
            },
            xcit: (0..levels).map(|_| CrossCovariance::of_itself(CONTEXT, device)).collect(),
            levels,
            strip_rows: None,
        }
    }

    /// Iterations at each level, coarsest first, in the proportions of the reference with `finest` at its finest level.
    fn iterations(&self, finest: usize) -> Vec<usize> {
        let of_all: &[usize] =
            if self.xcit.len() == ITERATIONS.len() { &ITERATIONS } else { &ITERATIONS_PLUS };
        let most = of_all.last().copied().unwrap_or(1);
        of_all.iter().take(self.levels).map(|own| (own * finest).div_ceil(most)).collect()
    }

    /// Features for matching from padded frames in -1..1, coarsest level first.
    fn matched(&self, frames: Tensor<4>) -> Vec<Tensor<4>> {
        let maps = self.fnet.forward(frames, self.levels);
        maps.into_iter().zip(self.fnet.outputs()).map(|(map, conv)| conv.forward(map, Identity)).collect()
    }
}

impl FlowNetwork for Ccmr {
    /// None are kept: those of both frames would take a quarter of the memory of a refinement, and save little time.
    fn features(&self, frames: Tensor<4>) -> Features {
        Features::new(frames.dims()[0], Vec::new())
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let (first, second, border) = frames.prepared(PADDING);
        let [batch, _, height, width] = first.dims();
        let device = first.device();
        let contexts = self.cnet.forward(first.clone(), self.levels);
        // One after the other: both at once would double the memory.
        let [firsts, seconds] = [first, second].map(|frames| self.matched(frames));
        let coarsest = [height, width].map(|side| side / COARSEST_STRIDE);
        let mut flow = request.start_flow(batch, coarsest, &device);
        let block = &self.update_block;
        let most = self.iterations(request.iterations);
        let mut iterations = None;
        let mut flows = Vec::new();
        let mut last = None;
        let levels = contexts.into_iter().zip(self.cnet.outputs()).zip(firsts.into_iter().zip(seconds));
        for (number, ((map, split), (first, second))) in levels.enumerate() {
            let aggregator = &block.aggregator[number];
            let context = |map| hidden_or_context(map, split, HIDDEN, Relu);
            let whole = context(map.clone());
            let attending = aggregator.attending(self.xcit[number].forward(whole.clone()));
            let [_, _, rows, columns] = map.dims();
            let strips = match self.strip_rows {
                _ if map.is_autodiff() => Strips::of_rows(rows, rows),
                Some(own) => Strips::of_rows(rows, own),
                None => Strips::new([rows, columns]),
            };
            let gru = strips.whole().then(|| block.gru.prepared(&whole));
            drop(whole);
            let mut hidden = strips.divided(map.clone(), |map| hidden_or_context(map, split, 0, Tanh));
            let correlation = Correlation::new(first, second, CORRELATION_LEVELS);
            let upsample =
                |hidden: &Divided, flow| convex_upsample_of_strips(strips, &block.mask, hidden, flow);
            let grid = pixel_grid([batch, rows, columns], &device);
            let mut refinement = request.refinement(most[number], border);
            loop {
                // The first iteration of a level also trains the upsampling from the level before.
                if refinement.done() > 0 || number == 0 {
                    flow = flow.detach();
                }
                let positions = grid.clone() + flow.clone();
                let (next, change) = match &gru {
                    Some(gru) => {
                        let windows = correlation.windows(positions, RADIUS);
                        let motion = block.encoder.forward(flow.clone(), windows);
                        let gathered = aggregator.gather(&attending, motion.clone());
                        let next = gru.step(hidden.whole(), concatenate(vec![motion, gathered]));
                        let change = block.flow_head.forward(next.clone());
                        (Divided::of_whole(next), change)
                    }
                    None => {
                        let motion = block.motion_of_strips(strips, &correlation, [flow.clone(), positions]);
                        let maps = [motion, map.clone()];
                        block.refine_strips(strips, aggregator, &attending, hidden, maps, context)
                    }
                };
                hidden = next;
                let end = refinement.ends_with(&change);
                flow = flow + change;
                if request.every_iteration || (end && number + 1 == self.levels) {
                    let whole = upsampled_to(height, upsample(&hidden, flow.clone()));
                    flows.push(border.remove(whole.clone()));
                    last = Some(whole);
                }
                if end {
                    break;
                }
            }
            iterations = Some(refinement.done());
            if number + 1 < self.levels {
                flow = upsample(&hidden, flow.detach());
            }
        }
        Estimate {
            coarse: last.map(|flow| resize_flow(flow, coarsest, Grids::CornersOnCorners)),
            iterations,
            ..Estimate::of_flows(flows)
        }
    }

    fn levels(&self, _: [usize; 2]) -> Option<usize> {
        Some(self.levels)
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        let allowed = if self.xcit.len() == ITERATIONS.len() { &[1, 2, 3][..] } else { &[1, 2, 3, 4] };
        vec![Setting {
            name: "levels",
            description: "levels at which flow is refined, starting from the coarsest at 1/16 of the size; default: all",
            allowed: Allowed::OneOf(allowed),
            in_files: None,
            value: &mut self.levels,
        }]
    }
}

/// Half of the channels that `layer` makes of a map of the context encoder, from `first` on: the first hidden state of a level, or
/// its context.
fn hidden_or_context(map: Tensor<4>, layer: &Conv2d, first: usize, activation: Activation) -> Tensor<4> {
    let bias = layer.bias().map(|bias| bias.narrow(0, first, HIDDEN));
    let weight = layer.weight().narrow(0, first, HIDDEN);
    layer.apply(map, weight, &WeightCache::default(), Epilogue::with(activation).bias(bias))
}

impl UpdateBlock {
    /// Motion features of a flow and the positions to which it leads, in strips.
    fn motion_of_strips(&self, strips: Strips, correlation: &Correlation, maps: [Tensor<4>; 2]) -> Tensor<4> {
        let [motion] = strips.map(maps, MOTION_REACH, |rows, [flow, positions]| {
            [self.encoder.forward(flow, correlation.of_rows(rows).windows(positions, RADIUS))]
        });
        motion
    }

    /// The next hidden state and the change of the flow, in strips, from the hidden state, motion features, and a map from which
    /// `context` makes the context.
    fn refine_strips(
        &self,
        strips: Strips,
        aggregator: &CrossCovariance,
        attending: &Attending,
        mut hidden: Divided,
        [motion, map]: [Tensor<4>; 2],
        context: impl Fn(Tensor<4>) -> Tensor<4>,
    ) -> (Divided, Tensor<4>) {
        let [_, _, height, width] = motion.dims();
        let sums = aggregator.sums(strips, attending, &motion);
        let inputs = [motion, map, attending.map().clone()];
        let (mut next, mut changes) = (Divided::default(), Vec::new());
        let of_strip = |rows: Range<usize>, [motion, map, attending_map]: [Tensor<4>; 3]| {
            // Strips above were refined, and strips below read only these rows and those below.
            hidden.free_above(rows.start);
            let attending = attending.part(attending_map);
            let gathered = aggregator.gather_strip(&attending, motion.clone(), &sums, height * width);
            let input = concatenate(vec![motion, gathered]);
            let hidden = self.gru.step(&context(map), hidden.rows(rows), input);
            [hidden.clone(), self.flow_head.forward(hidden)]
        };
        strips.each(&inputs, REFINEMENT_REACH, of_strip, |[hidden, change]| {
            next.push(hidden);
            changes.push(change);
        });
        (next, Tensor::cat(changes, 2))
    }
}

/// Doubles the size of a flow until it has this height (`upflow2`).
fn upsampled_to(height: usize, mut flow: Tensor<4>) -> Tensor<4> {
    while flow.dims()[2] < height {
        let [_, _, rows, columns] = flow.dims();
        flow = resize_flow(flow, [2 * rows, 2 * columns], Grids::CornersOnCorners);
    }
    flow
}

fn through(layer: &[Block], x: Tensor<4>) -> Tensor<4> {
    layer.iter().fold(x, |x, block| block.forward(x))
}

impl Encoder {
    /// An encoder with `outputs` output channels at each level, by default those of the level below.
    fn new(levels: usize, outputs: Option<usize>, device: &Device) -> Self {
        let config = EncoderConfig::basic(0, NormKind::Group);
        let layer = |inputs, outputs, stride| {
            vec![config.block([inputs, outputs], stride, device), config.block([outputs, outputs], 1, device)]
        };
        let [half, quarter, eighth, sixteenth] = WIDTHS;
        let out = |width| outputs.unwrap_or(width);
        let last = |width| encoder_conv([width, out(width)], 1).init(device);
        let up = |coarser, width| {
            let first = config.block([out(coarser) + width, width], 1, device).without_shortcut();
            vec![first, config.block([width, width], 1, device)]
        };
        let four = levels == ITERATIONS_PLUS.len();
        Self {
            conv1: encoder_conv([3, half], 7).with_stride(2).init(device),
            norm1: Norm::new(NormKind::Group, half, device),
            layer1: layer(half, half, 1),
            layer2: layer(half, quarter, 2),
            layer3: layer(quarter, eighth, 2),
            layer4: layer(eighth, sixteenth, 2),
            conv2: last(sixteenth),
            up_layer2: up(sixteenth, eighth),
            after_up_layer2_conv: last(eighth),
            up_layer1: up(eighth, quarter),
            after_up_layer1_conv: last(quarter),
            up_layer0: four.then(|| up(quarter, half)),
            after_up_layer0_conv: four.then(|| last(half)),
        }
    }

    /// The output layers, coarsest level first.
    fn outputs(&self) -> impl Iterator<Item = &Conv2d> {
        let three = [&self.conv2, &self.after_up_layer2_conv, &self.after_up_layer1_conv];
        three.into_iter().chain(&self.after_up_layer0_conv)
    }

    /// The inputs of the [`outputs`](Self::outputs) of this many levels, coarsest first.
    fn forward(&self, frames: Tensor<4>, levels: usize) -> Vec<Tensor<4>> {
        let mut x = through(&self.layer1, self.norm1.after(&self.conv1, frames, Relu));
        let mut finer = vec![x.clone()];
        for layer in [&self.layer2, &self.layer3] {
            x = through(layer, x);
            finer.push(x.clone());
        }
        x = through(&self.layer4, x);
        let mut maps = vec![x.clone()];
        let ups = [&self.up_layer2, &self.up_layer1].into_iter().chain(&self.up_layer0).zip(self.outputs());
        for (layer, output) in ups.take(levels - 1) {
            let Some(own) = finer.pop() else { break };
            let [_, _, height, width] = own.dims();
            let coarser = output.forward(x, Identity);
            let [_, channels, _, _] = coarser.dims();
            let enlarged = (0..channels).step_by(PART).map(|first| {
                let part = coarser.clone().narrow(1, first, PART.min(channels - first));
                resize(part, [height, width], Grids::EdgesOnEdges)
            });
            let [first, rest @ ..] = layer.as_slice() else { break };
            x = through(rest, first.forward_parts(enlarged.chain([own])));
            maps.push(x.clone());
        }
        maps
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::TensorData;
    use srflow_ops::golden::numbers;

    use super::*;

    fn frame(shift: usize) -> Tensor<4> {
        let place = |i: usize| [i / 3 / 9216 * 7 + i % 9216 / 128, i % 128 + shift];
        let value = |i: usize| {
            let [y, x] = place(i);
            ((x * x + 3 * x * y + 11 * y) % 97) as f32 / 97.0
        };
        Tensor::from_data(
            TensorData::new((0..2 * 3 * 9216).map(value).collect(), [2, 3, 72, 128]),
            &Device::flex(),
        )
    }

    /// Of two pairs, with as many rows as divide some levels and not others.
    #[test]
    fn strips_give_the_flow_of_the_whole() {
        let mut network = Ccmr::new(&ITERATIONS_PLUS, &Device::flex());
        let flow = |network: &Ccmr| {
            let frames = Frames { first: frame(0), second: frame(2) };
            numbers(network.forward(frames, &Request::new(2)).last().clone())
        };
        let whole = flow(&network);
        let longest = whole.iter().fold(0.0_f32, |most, x| most.max(x.abs()));
        for rows in [8, 11] {
            network.strip_rows = Some(rows);
            let far = whole.iter().zip(flow(&network)).fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
            assert!(far < 1e-4 * longest && longest > 0.1, "strips of {rows} rows: {far} px of {longest}");
        }
    }
}
