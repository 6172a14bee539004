//! The network of srflow's own: small and fast, for the small motions of faces. It starts from what TV-L1 finds at half of the size, and
//! corrects that flow by a U-Net, repeatedly with shared weights and with frame 2 warped, as in RAFT; uncertainty is SEA-RAFT's. From
//! coarse to fine, the U-Net blends the start with the flow of the coarser size, so that it can fill a head with one smooth motion up to
//! the outline. It also sees what the method of Lucas and Kanade finds between frame 1 and the warped frame 2, and decides how much
//! of that to add. The last correction of small frames is at twice their size. `tools/parity/srflow_net.py` is the same in
//! PyTorch, but for the start and for what is done in small and in large frames.
//!
//! A correction depends on the frames and on the flow that it corrects alone, its inputs are bounded, and it cannot enlarge a flow: it
//! blends flows, and adds a bounded change. So any number of corrections is safe. What explains the frames clearly worse than an earlier
//! flow does is undone, see [`Explained`].

use std::sync::LazyLock;

use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::ops::PadMode;
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use srflow_classical::{TvL1, TvL1Parameters};
use srflow_core::{LUMA, Plane};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig};
use srflow_ops::Activation::{Identity, LeakyRelu};
use srflow_ops::concatenate;
use srflow_ops::convolution::Epilogue;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::lucas_kanade::tensor::lucas_kanade;
use srflow_ops::lucas_kanade::{CELL, LucasKanade, PER_WINDOW};
use srflow_ops::space_to_depth::tensor::space_to_depth;
use srflow_ops::upsample::tensor::convex_upsample;
use srflow_ops::warp::tensor::warp_replicated;

use crate::blocks::{Grids, resize, resize_flow};
use crate::estimate::{Estimate, LaplaceMixture, Request};
use crate::facts::{Facts, IterationPresets, Start};
use crate::features::Features;
use crate::frames::{Border, Frames};
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::settings::{Allowed, Setting};

/// Pixels of the frame per pixel of the map that is corrected, along each axis: a cell.
pub(crate) const STRIDE: usize = 2;
/// Channels from 1/2 to 1/32 of the size. The motion of a head is smooth up to its outline, which takes a wide view.
pub(crate) const WIDTHS: [usize; 5] = [32, 64, 96, 128, 160];
/// Pixels of the frame per pixel of the coarsest map.
const COARSEST_STRIDE: usize = STRIDE << (WIDTHS.len() - 1);
/// Channels at the finest size.
pub(crate) const STATE: usize = WIDTHS[0];
/// Windows of the evidence.
pub(crate) const WINDOWS: usize = 2;
/// Logarithms of the weights and of the scales of two Laplace distributions.
pub(crate) const MIXTURE: usize = 2 + 2;
/// At each size: the share of the coarser flow in place of the start's, a change, and the mixture.
const OUTPUTS: usize = 1 + 2 + MIXTURE;
/// Pixels of a frame in a cell.
const PIXELS: usize = 3 * STRIDE * STRIDE;
/// What a correction sees of the frames as they are, see [`still`].
const STILL: usize = PIXELS + STRIDE * STRIDE + LucasKanade::OUTPUTS;
/// What it sees: that, the difference from the warped frame 2, the evidence and the flow.
const SEEN: usize = STILL + PIXELS + LucasKanade::OUTPUTS + 2;
/// The network sees flows up to this many cells; to it, longer ones are of this length.
pub(crate) const SEEN_CELLS: f64 = 8.0;
/// Scale of differences of frames, which are small where the flow is nearly right.
pub(crate) const DIFFERENCE_SCALE: f64 = 4.0;
/// What brightness says about the remaining motion. The noise is the square of about 1.5 of 255 levels.
pub(crate) const EVIDENCE: LucasKanade = LucasKanade { radii: [1, 3], noise: 1.4e-4, reach: 2.0 };
/// As [`LaplaceMixture::LOG_SCALE_RANGE`]: errors are small parts of a pixel.
pub(crate) const LOG_SCALE_RANGE: [f64; 2] = [-2.3, 10.0];
/// Initial weight of a cell that bilinear interpolation leaves out; it can be learned.
const NOT_BILINEAR: f32 = 1.0 / 128.0;
/// A flow is clearly worse where its residual is more than this much of the other's, and this much, in frames from -1 to 1.
pub(crate) const WORSE_FACTOR: f64 = 1.1;
pub(crate) const WORSE_BY: f64 = 0.01;
/// Cells to each side whose residuals are averaged.
pub(crate) const AROUND: usize = 4;
/// More warps hardly change the flow of faces, and fit more of the noise of backgrounds.
const WARPS: usize = 2;
/// Down to a sixth of the half size, for motion of tens of pixels. The coarse scales take little time.
const SCALES: usize = 9;
static TV_L1: LazyLock<TvL1> = LazyLock::new(|| tv_l1(SCALES));
/// At the size of the frames, with a coarsest scale like that of [`TV_L1`].
static FINE_TV_L1: LazyLock<TvL1> = LazyLock::new(|| tv_l1(SCALES + 3));

fn tv_l1(nscales: usize) -> TvL1 {
    let parameters = TvL1Parameters { nscales, warps: WARPS, ..Default::default() };
    TvL1::new(parameters).expect("parameters within their ranges")
}

/// Default of the setting `fine_up_to`: frames of 362x362 pixels, for which it takes no longer than frames of 550x802 take without.
pub(crate) const FINE_UP_TO: usize = 1 << 17;
/// Larger frames, padded, start from what the network finds at half of their size: it was trained on frames of 440x640.
const COARSE_ABOVE: usize = 1 << 20;

/// A static, which a program contains once; the table is a constant, which it copies to each use.
static WEIGHTS: [u8; include_bytes!("../weights/srflow.safetensors").len()] =
    *include_bytes!("../weights/srflow.safetensors");

pub(crate) const SRFLOW: Entry<SrFlow> = Entry {
    facts: Facts {
        name: "srflow",
        title: "srflow",
        parameters: 1_572_937,
        padding: COARSEST_STRIDE,
        smallest_side: 2 * COARSEST_STRIDE,
        iterations: IterationPresets { default: 2, authors: 2, training: 2 },
        start: Start::Coarse(STRIDE),
        trains: true,
        mixture: true,
        log_scale_range: LOG_SCALE_RANGE,
        memory: MemoryNeed { fixed: 325_000_000, per_pixel: 343, attending: 0, most_weights: 0 },
        in_ptlflow: false,
        included: Some(&WEIGHTS),
        licence: "MIT OR Apache-2.0",
        ..Facts::DEFAULT
    },
    init: SrFlow::new,
};

#[derive(Module, Debug)]
pub struct SrFlow {
    enter: Conv2d,
    /// To 1/4 of the size, to 1/8 and so on.
    down: Vec<Step>,
    /// To 1/2 of the size, to 1/4 and so on.
    up: Vec<Conv2d>,
    /// At 1/2 of the size, at 1/4 and so on.
    predict: Vec<Conv2d>,
    /// Share of the motion that each window of the evidence shows, to be added.
    evidence: Conv2d,
    /// Weights of the 9 neighbouring cells of each pixel of a cell.
    mask: Conv2d,
    /// Pixels of the largest frames, padded, whose last correction is at twice their size.
    fine_up_to: usize,
}

/// Halves the size.
#[derive(Module, Debug)]
struct Step {
    down: Conv2d,
    same: Conv2d,
}

/// An estimate at one of the sizes.
struct Found {
    /// In cells.
    flow: Tensor<4>,
    mixture: Tensor<4>,
    state: Tensor<4>,
}

/// Initialized so that activations keep their size, as there is no normalization.
fn conv(inputs: usize, outputs: usize, stride: usize, device: &Device) -> Conv2d {
    Conv2dConfig::new([inputs, outputs], [3, 3])
        .with_stride(stride)
        .with_initializer(Initializer::KaimingNormal { gain: std::f64::consts::SQRT_2, fan_out_only: false })
        .with_bias_initializer(Initializer::Zeros)
        .init(device)
}

/// At first nothing is changed: untrained, the network is its start.
fn prediction(channels: usize, outputs: usize, device: &Device) -> Conv2d {
    Conv2dConfig::new([channels, outputs], [3, 3])
        .with_initializer(Initializer::Zeros)
        .with_bias_initializer(Initializer::Zeros)
        .init(device)
}

/// Weights of upsampling that are bilinear at first: random ones repeat in each cell, and so draw a lattice into the flow.
fn bilinear_mask(device: &Device) -> Conv2d {
    // Of the cell before, the one of the pixel, and the one after, for the first pixel of a cell and for the second.
    let along = [[0.25_f32, 0.75, NOT_BILINEAR], [NOT_BILINEAR, 0.75, 0.25]];
    let mut scores = Vec::with_capacity(9 * STRIDE * STRIDE);
    for neighbour in 0..9 {
        for pixel in 0..STRIDE * STRIDE {
            let weight = along[pixel / STRIDE][neighbour / 3] * along[pixel % STRIDE][neighbour % 3];
            scores.push(weight.ln());
        }
    }
    Conv2dConfig::new([STATE, 9 * STRIDE * STRIDE], [3, 3])
        .with_initializer(Initializer::Zeros)
        .with_bias_initializer(Initializer::Values { values: scores })
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
        let levels = || WIDTHS.windows(2).map(|pair| (pair[0], pair[1]));
        Self {
            enter: conv(SEEN, WIDTHS[0], 1, device),
            down: levels().map(|(fine, coarse)| Step::new(fine, coarse, device)).collect(),
            up: levels().map(|(fine, coarse)| conv(coarse + fine + 2, fine, 1, device)).collect(),
            predict: WIDTHS.map(|channels| prediction(channels, OUTPUTS, device)).into(),
            evidence: prediction(STATE, WINDOWS, device),
            mask: bilinear_mask(device),
            fine_up_to: FINE_UP_TO,
        }
    }

    /// The flow of an estimate in pixels, `[batch, 2, height, width]`.
    fn upsampled(&self, found: &Found) -> Tensor<4> {
        let weights = self.mask.forward(found.state.clone(), Identity);
        without_lattice(convex_upsample(found.flow.clone(), weights, 1.0, STRIDE))
    }

    /// `flow`, in pixels, corrected once at twice the size of the frames, where a cell is a pixel.
    fn finer(&self, frames: [&Tensor<4>; 2], flow: Tensor<4>) -> Tensor<4> {
        let [first, second] = frames.map(|frame| twice(frame.clone()));
        let warped = warp_replicated(second.clone(), in_pixels(flow.clone()));
        let mut found = self.corrected(&first, &still([&first, &second]), flow, warped);
        // Upsampled, as it was trained: the flow of the cells alone is less exact.
        halved(self.upsampled(&found.pop().expect("several sizes"))) / STRIDE as f64
    }

    /// The estimates that follow on a flow in cells, from 1/32 to 1/2 of the size; `warped` is frame 2 warped by it.
    fn corrected(
        &self,
        first: &Tensor<4>,
        still: &Tensor<4>,
        flow: Tensor<4>,
        warped: Tensor<4>,
    ) -> Vec<Found> {
        let evidence = lucas_kanade(EVIDENCE, first.clone(), warped.clone());
        let difference = space_to_depth((first.clone() - warped) * DIFFERENCE_SCALE, STRIDE);
        let seen = vec![still.clone(), difference, evidence.clone(), seen_flow(flow.clone())];
        // From fine to coarse, with the flow at each size.
        let mut maps = vec![self.enter.forward(concatenate(seen), LeakyRelu)];
        let mut starts = vec![flow];
        for step in &self.down {
            maps.push(step.forward(maps[maps.len() - 1].clone()));
            starts.push(halved(starts[starts.len() - 1].clone()));
        }
        let mut found: Vec<Found> = Vec::with_capacity(maps.len());
        for (level, (map, start)) in maps.into_iter().zip(starts).enumerate().rev() {
            let (state, coarser) = match found.last() {
                None => (map, start.zeros_like()),
                Some(coarser) => {
                    let (state, flow) = (twice(coarser.state.clone()), twice(coarser.flow.clone()));
                    let seen = vec![state, map, seen_flow(flow.clone() - start.clone())];
                    (self.up[level].forward(concatenate(seen), LeakyRelu), flow)
                }
            };
            let predicted = self.predict[level].forward(state.clone(), Identity);
            // From 0 to 1: a share below 0 would enlarge differences, by more at each correction.
            let share = relu(predicted.clone().narrow(1, 0, 1).tanh());
            let flow = start.clone() + (coarser - start) * share + predicted.clone().narrow(1, 1, 2);
            found.push(Found { flow, mixture: predicted.narrow(1, 3, MIXTURE), state });
        }
        let finest = found.last_mut().expect("several sizes");
        let shares = self.evidence.forward(finest.state.clone(), Identity).tanh();
        for window in 0..WINDOWS {
            let motion = evidence.clone().narrow(1, window * PER_WINDOW, 2) / CELL as f64;
            finest.flow = finest.flow.clone() + motion * shares.clone().narrow(1, window, 1);
        }
        found
    }

    /// Estimates between padded frames in -1..1, without their border.
    fn estimate(&self, frames: [&Tensor<4>; 2], border: Border, request: &Request) -> Estimate {
        let [batch, _, height, width] = frames[0].dims();
        let cells = [height / STRIDE, width / STRIDE];
        let device = frames[0].device();
        let pixels = height * width;
        // Training has crops of larger frames.
        let fine = pixels <= self.fine_up_to && request.iterations > 1 && !request.every_iteration;
        let iterations = if fine { request.iterations - 1 } else { request.iterations };
        let mut flow = match &request.start {
            Some(_) => request.start_flow(batch, cells, &device),
            None if pixels > COARSE_ABOVE && !request.every_iteration => self.start_of_large(frames, request),
            None => start(frames, border, fine),
        };
        // A network learns more from its mistakes than from what undoes them.
        let mut kept: Option<Explained> = None;
        let mut estimate = Estimate::of_flows(Vec::new());
        let mut add = |flow: Tensor<4>, mixture: Tensor<4>| {
            let mixture = resize(mixture, [height, width], Grids::EdgesOnEdges);
            let part = |from| border.remove(mixture.clone().narrow(1, from, 2));
            estimate.flows.push(border.remove(flow));
            estimate.mixtures.push(LaplaceMixture { log_weights: part(0), log_scales: part(2) });
        };
        let still = still(frames);
        for iteration in 1..=iterations {
            // Each correction learns by its own predictions, as in RAFT.
            let explained = Explained::by(frames, flow.detach());
            let explained = match kept.take() {
                Some(before) if !request.every_iteration => explained.or(before),
                _ => explained,
            };
            let Explained { flow: start, warped, .. } = explained.clone();
            let mut found = self.corrected(frames[0], &still, start, warped);
            let finest = found.pop().expect("several sizes");
            if request.every_iteration {
                // Every second size is enough to teach the coarse maps.
                for Found { flow, mixture, .. } in found.into_iter().step_by(2) {
                    add(resize(flow, [height, width], Grids::EdgesOnEdges) * STRIDE as f64, mixture);
                }
                add(self.upsampled(&finest), finest.mixture);
            } else if iteration == iterations {
                let found = self.upsampled(&finest);
                let found = if fine { self.finer(frames, found) } else { found };
                add(explained.or_flow(frames, found), finest.mixture);
            }
            (flow, kept) = (finest.flow, Some(explained));
        }
        Estimate { coarse: Some(flow), iterations: Some(request.iterations), ..estimate }
    }

    /// The flow between the frames at half of their size, whose pixels are cells.
    fn start_of_large(&self, frames: [&Tensor<4>; 2], request: &Request) -> Tensor<4> {
        let [first, second] = frames.map(|frame| halved(frame.clone()));
        let [_, _, height, width] = first.dims();
        let border = Border::new([height, width], COARSEST_STRIDE);
        let estimate = self.estimate(
            [&border.add(first), &border.add(second)],
            border,
            &Request::new(request.iterations),
        );
        estimate.last().clone()
    }
}

/// A flow, and how well it explains frame 1 by frame 2.
#[derive(Clone)]
struct Explained {
    /// In cells.
    flow: Tensor<4>,
    /// Frame 2 warped by the flow.
    warped: Tensor<4>,
    /// Mean absolute difference of frame 1 from that, around each cell. It is the least of all flows that were here before.
    residual: Tensor<4>,
}

impl Explained {
    fn by([first, second]: [&Tensor<4>; 2], flow: Tensor<4>) -> Self {
        let warped = warp_replicated(second.clone(), in_pixels(flow.clone()));
        let residual = residual(first, &warped);
        Self { flow, warped, residual }
    }

    /// This flow, but `before` wherever this one explains the frames clearly worse.
    fn or(self, before: Self) -> Self {
        let worse = is_worse(&self.residual, &before.residual);
        let worse_pixels = nearest_twice(worse.clone());
        Self {
            flow: blend(worse, before.flow, self.flow),
            warped: blend(worse_pixels, before.warped, self.warped),
            residual: self.residual.min_pair(before.residual),
        }
    }

    /// `found`, in pixels, but this flow wherever `found` explains the frames clearly worse.
    fn or_flow(&self, [first, second]: [&Tensor<4>; 2], found: Tensor<4>) -> Tensor<4> {
        let residual = residual(first, &warp_replicated(second.clone(), found.clone()));
        let worse = nearest_twice(is_worse(&residual, &self.residual));
        blend(worse, in_pixels(self.flow.clone()), found)
    }
}

/// 1 where `residual` is more than `before` by more than noise makes it, else 0.
fn is_worse(residual: &Tensor<4>, before: &Tensor<4>) -> Tensor<4> {
    residual.clone().greater(before.clone() * WORSE_FACTOR + WORSE_BY).float()
}

/// `one` where `share` is 1, `other` where it is 0.
fn blend(share: Tensor<4>, one: Tensor<4>, other: Tensor<4>) -> Tensor<4> {
    other.clone() + (one - other) * share
}

/// Mean absolute difference around each cell.
fn residual(first: &Tensor<4>, warped: &Tensor<4>) -> Tensor<4> {
    mean_around(halved((first.clone() - warped.clone()).abs().mean_dim(1)))
}

/// The mean over [`AROUND`] cells to each side of every cell of a map of one channel, as far as there are any.
fn mean_around(cells: Tensor<4>) -> Tensor<4> {
    const SIDE: usize = 2 * AROUND + 1;
    let [_, _, height, width] = cells.dims();
    let device = cells.device();
    let sum = |x: Tensor<4>, kernel: [usize; 2]| {
        let ones = Tensor::ones([1, 1, kernel[0], kernel[1]], &device);
        depthwise(x, ones, Epilogue::default(), kernel.map(|side| side / 2))
    };
    let counted = |len: usize| {
        (0..len).map(move |at| (at.min(AROUND) + 1 + (len - 1 - at).min(AROUND)) as f32).collect::<Vec<f32>>()
    };
    let counts =
        |len: usize, shape: [usize; 4]| Tensor::<4>::from_data(TensorData::new(counted(len), shape), &device);
    let sums = sum(sum(cells, [SIDE, 1]), [1, SIDE]);
    sums / counts(height, [1, 1, height, 1]) / counts(width, [1, 1, 1, width])
}

/// Each cell as its pixels.
fn nearest_twice(x: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = x.dims();
    let pixels =
        x.reshape([batch * channels, height, 1, width, 1]).expand([batch * channels, height, 2, width, 2]);
    pixels.reshape([batch, channels, 2 * height, 2 * width])
}

/// `flow` without what alternates from pixel to pixel: the learned weights of upsampling repeat in each cell, and would leave that as a
/// lattice in the strain. Means over 1, 2, 1 along each axis are zero for it.
fn without_lattice(flow: Tensor<4>) -> Tensor<4> {
    const ALONG: [f32; 3] = [0.25, 0.5, 0.25];
    let [_, channels, _, _] = flow.dims();
    let kernel = ALONG.map(|down| ALONG.map(|across| down * across));
    let kernels = TensorData::new(kernel.as_flattened().repeat(channels), [channels, 1, 3, 3]);
    let kernels = Tensor::from_data(kernels, &flow.device());
    depthwise(flow.pad((1, 1, 1, 1), PadMode::Edge), kernels, Epilogue::default(), [0, 0])
}

/// A flow in cells as one of the pixels of the frames.
fn in_pixels(flow: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    resize_flow(flow, [STRIDE * height, STRIDE * width], Grids::EdgesOnEdges)
}

/// What the network sees of a flow in cells: short ones as they are, none longer than [`SEEN_CELLS`].
fn seen_flow(flow: Tensor<4>) -> Tensor<4> {
    flow.clone() / (flow.square() * (1.0 / (SEEN_CELLS * SEEN_CELLS)) + 1.0).sqrt()
}

/// The pixels of frame 1 in each cell, how far their mean over the channels is from that of frame 2 where nothing moves, and the evidence
/// there.
fn still([first, second]: [&Tensor<4>; 2]) -> Tensor<4> {
    let change = (first.clone() - second.clone()).mean_dim(1) * DIFFERENCE_SCALE;
    let evidence = lucas_kanade(EVIDENCE, first.clone(), second.clone());
    concatenate(vec![space_to_depth(first.clone(), STRIDE), space_to_depth(change, STRIDE), evidence])
}

/// What TV-L1 finds, in cells, `[batch, 2, height / 2, width / 2]`: between the means of cells, or if `fine` between the pixels of the
/// frames without their border.
fn start(frames: [&Tensor<4>; 2], border: Border, fine: bool) -> Tensor<4> {
    if !fine {
        return between(&TV_L1, frames.map(|frame| halved(frame.clone())));
    }
    let flow = between(&FINE_TV_L1, frames.map(|frame| border.remove(frame.clone())));
    halved(border.add(flow)) / STRIDE as f64
}

/// The flow of TV-L1 between frames, computed on the CPU.
fn between(method: &TvL1, frames: [Tensor<4>; 2]) -> Tensor<4> {
    let [batch, _, height, width] = frames[0].dims();
    let device = frames[0].device();
    let planes = |frames: Tensor<4>| {
        let numbers: Vec<f32> =
            frames.detach().into_data().convert::<f32>().try_to_vec().expect("converted to f32");
        let luminance = |frame: &[f32]| {
            Plane::from_fn(width, height, |x, y| {
                let at = y * width + x;
                let channels = LUMA.iter().zip(frame.chunks_exact(width * height));
                127.5 * (1.0 + channels.map(|(weight, channel)| weight * channel[at]).sum::<f32>())
            })
        };
        numbers.chunks_exact(3 * width * height).map(luminance).collect::<Vec<Plane>>()
    };
    let [firsts, seconds] = frames.map(planes);
    let flow = |(first, second)| {
        let flow = method.between_planes(first, second).expect("frames of one size");
        let component = |axis| flow.pixels().iter().map(move |vector: &[f32; 2]| vector[axis]);
        component(0).chain(component(1)).collect::<Vec<f32>>()
    };
    let flows: Vec<Vec<f32>> = firsts.into_par_iter().zip(seconds).map(flow).collect();
    Tensor::from_data(TensorData::new(flows.concat(), [batch, 2, height, width]), &device)
}

/// `x` at half of the size.
fn halved(x: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = x.dims();
    resize(x, [height / 2, width / 2], Grids::EdgesOnEdges)
}

/// `x` at twice the size.
fn twice(x: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = x.dims();
    resize(x, [2 * height, 2 * width], Grids::EdgesOnEdges)
}

impl FlowNetwork for SrFlow {
    fn features(&self, frames: Tensor<4>) -> Features {
        Features::new(frames.dims()[0], Vec::new())
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        assert!(request.iterations > 0, "at least one iteration");
        let (first, second, border) = frames.prepared(COARSEST_STRIDE);
        self.estimate([&first, &second], border, request)
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![Setting {
            name: "fine_up_to",
            description: "pixels of the largest frames whose last iteration is at twice their size; 0 for none",
            allowed: Allowed::Range(0..=1 << 20),
            in_files: None,
            value: &mut self.fine_up_to,
        }]
    }
}

#[cfg(test)]
mod tests {
    use srflow_ops::golden::numbers;

    use super::*;
    use crate::included::load_included;
    use crate::table::Architecture;

    /// Waves of a few pixels, moved by `[u, v]`.
    fn frame([u, v]: [f32; 2]) -> Tensor<4> {
        let [height, width] = [60, 76];
        let pixel = |c: usize, y: f32, x: f32| {
            0.5 + 0.2 * ((0.4 + 0.1 * c as f32) * x).sin() * (0.3 * y).cos() + 0.1 * (0.7 * y - 0.2 * x).sin()
        };
        let values: Vec<f32> = (0..3 * height * width)
            .map(|i| pixel(i / (height * width), (i / width % height) as f32 - v, (i % width) as f32 - u))
            .collect();
        Tensor::from_data(TensorData::new(values, [1, 3, height, width]), &Device::flex())
    }

    #[test]
    fn untrained_it_gives_its_start() {
        let frames = Frames { first: frame([0.0, 0.0]), second: frame([1.5, -0.75]) };
        let network = SrFlow::new(&Device::flex());
        // By default that of TV-L1.
        let found = network.forward(frames.clone(), &Request::new(2));
        let away = error(found.last(), [1.5, -0.75]);
        assert!(away < 0.2, "{away}");
        assert_eq!(found.coarse.expect("for a warm start").dims(), [1, 2, 32, 48]);
        // Or a given one, in cells.
        let start = Tensor::<1>::from_floats([2.0, 1.0], &Device::flex())
            .reshape([1, 2, 1, 1])
            .expand([1, 2, 32, 48]);
        let found = network.forward(frames, &Request { start: Some(start), ..Request::new(1) });
        let away = error(found.last(), [4.0, 2.0]);
        assert!(away < 1e-4, "{away}");
    }

    /// Mean distance of a flow from one in whole pixels, inside.
    fn error(flow: &Tensor<4>, truth: [f32; 2]) -> f32 {
        distance(flow.clone().narrow(2, 8, 44).narrow(3, 8, 60), truth)
    }

    fn distance(flow: Tensor<4>, truth: [f32; 2]) -> f32 {
        let flow = numbers(flow);
        let (u, v) = flow.split_at(flow.len() / 2);
        u.iter().zip(v).map(|(u, v)| (u - truth[0]).hypot(v - truth[1])).sum::<f32>() / u.len() as f32
    }

    #[test]
    fn more_iterations_never_ruin_a_flow() {
        let network = load_included(Architecture::SrFlow, &Device::flex()).expect("weights");
        let frames = || Frames { first: frame([0.0, 0.0]), second: frame([1.5, -0.75]) };
        let after =
            |iterations| error(network.forward(frames(), &Request::new(iterations)).last(), [1.5, -0.75]);
        let few = after(2);
        for many in [1, 3, 4, 8, 24, 64] {
            let found = after(many);
            assert!(found < few + 0.02, "{found} px after {many} iterations, {few} px after 2");
        }
    }

    #[test]
    fn a_start_that_explains_the_frames_is_kept() {
        let network = load_included(Architecture::SrFlow, &Device::flex()).expect("weights");
        let offset = [30.0, -12.0];
        let frames = Frames { first: frame([0.0, 0.0]), second: frame(offset) };
        let start = Tensor::<1>::from_floats([offset[0] / 2.0, offset[1] / 2.0], &Device::flex())
            .reshape([1, 2, 1, 1])
            .expand([1, 2, 32, 48]);
        let flow = |start, iterations| {
            let estimate = network.forward(frames.clone(), &Request { start, ..Request::new(iterations) });
            // Pixels that frame 2 shows.
            distance(estimate.last().clone().narrow(2, 16, 36).narrow(3, 8, 32), offset)
        };
        for iterations in [1, 2, 8] {
            let found = flow(Some(start.clone()), iterations);
            // A hundredth of the motion.
            assert!(found < 0.32, "{found} px after {iterations} iterations");
        }
    }
}
