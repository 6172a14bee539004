//! The network of srflow's own: small and fast, for the small motions of faces. It starts from what TV-L1 finds at half of the size, and
//! corrects that flow by a U-Net, repeatedly with shared weights and with frame 2 warped, as in RAFT; uncertainty is SEA-RAFT's. From
//! coarse to fine, the U-Net blends the start with the flow of the coarser size, so that it can fill a head with one smooth motion up to
//! the outline. It also sees what the method of Lucas and Kanade finds between frame 1 and the warped frame 2, and decides how much
//! of that to add. The last correction of small frames is at twice their size. `tools/parity/srflow_net.py` is the same in
//! PyTorch, but for the start and for what is done in small and in large frames.

use std::sync::LazyLock;

use burn::module::Module;
use burn::tensor::module::avg_pool2d;
use burn::tensor::ops::AvgPoolOptions;
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use srflow_classical::{TvL1, TvL1Parameters};
use srflow_core::Plane;
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig};
use srflow_ops::Activation::{Identity, LeakyRelu};
use srflow_ops::concatenate;
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
/// Channels that a correction hands to the next one.
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
/// What it sees: that, the difference from the warped frame 2, the evidence, the flow and the state.
const SEEN: usize = STILL + PIXELS + LucasKanade::OUTPUTS + 2 + STATE;
/// Scale of differences of frames, which are small where the flow is nearly right.
pub(crate) const DIFFERENCE_SCALE: f64 = 4.0;
/// What brightness says about the remaining motion. The noise is the square of about 1.5 of 255 levels.
pub(crate) const EVIDENCE: LucasKanade = LucasKanade { radii: [1, 3], noise: 1.4e-4, reach: 2.0 };
/// As [`LaplaceMixture::LOG_SCALE_RANGE`]: errors are small parts of a pixel.
pub(crate) const LOG_SCALE_RANGE: [f64; 2] = [-2.3, 10.0];
/// Weights of red, green and blue in luminance.
const LUMINANCE: [f32; 3] = [0.299, 0.587, 0.114];
/// More warps hardly change the flow of faces, and fit more of the noise of backgrounds.
const WARPS: usize = 2;
static TV_L1: LazyLock<TvL1> = LazyLock::new(|| tv_l1(TvL1Parameters::default().nscales));
/// At the size of the frames, with a coarsest scale like that of [`TV_L1`].
static FINE_TV_L1: LazyLock<TvL1> = LazyLock::new(|| tv_l1(TvL1Parameters::default().nscales + 3));

fn tv_l1(nscales: usize) -> TvL1 {
    let parameters = TvL1Parameters { nscales, warps: WARPS, ..Default::default() };
    TvL1::new(parameters).expect("parameters within their ranges")
}

/// Default of the setting `fine_up_to`: frames of 362x362 pixels, for which it takes no longer than frames of 550x802 take without.
pub(crate) const FINE_UP_TO: usize = 1 << 17;
/// Larger frames, padded, start from what the network finds at half of their size: it was trained on frames of 440x640.
const COARSE_ABOVE: usize = 1 << 20;

pub(crate) const SRFLOW: Entry<SrFlow> = Entry {
    facts: Facts {
        name: "srflow",
        title: "srflow",
        parameters: 1_582_153,
        padding: COARSEST_STRIDE,
        smallest_side: 2 * COARSEST_STRIDE,
        iterations: IterationPresets { default: 2, authors: 2, training: 2 },
        start: Start::Coarse(STRIDE),
        trains: true,
        mixture: true,
        log_scale_range: LOG_SCALE_RANGE,
        memory: MemoryNeed { fixed: 325_000_000, per_pixel: 343, attending: 0, most_weights: 0 },
        in_ptlflow: false,
        included: Some(include_bytes!("../weights/srflow.safetensors")),
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
            mask: conv(STATE, 9 * STRIDE * STRIDE, 1, device),
            fine_up_to: FINE_UP_TO,
        }
    }

    /// The flow of an estimate in pixels, `[batch, 2, height, width]`.
    fn upsampled(&self, found: &Found) -> Tensor<4> {
        let weights = self.mask.forward(found.state.clone(), Identity);
        convex_upsample(found.flow.clone(), weights, 1.0, STRIDE)
    }

    /// `flow`, in pixels, corrected once at twice the size of the frames, where a cell is a pixel.
    fn finer(&self, frames: [&Tensor<4>; 2], flow: Tensor<4>) -> Tensor<4> {
        let [batch, _, height, width] = flow.dims();
        let [first, second] = frames.map(|frame| twice(frame.clone()));
        let state = Tensor::zeros([batch, STATE, height, width], &flow.device());
        let mut found = self.corrected([&first, &second], &still([&first, &second]), [flow, state]);
        // Upsampled, as it was trained: the flow of the cells alone is less exact.
        halved(self.upsampled(&found.pop().expect("several sizes"))) / STRIDE as f64
    }

    /// The estimates that follow on a flow and state, from 1/32 to 1/2 of the size.
    fn corrected(
        &self,
        [first, second]: [&Tensor<4>; 2],
        still: &Tensor<4>,
        [flow, state]: [Tensor<4>; 2],
    ) -> Vec<Found> {
        let [_, _, height, width] = first.dims();
        let warped =
            warp_replicated(second.clone(), resize_flow(flow.clone(), [height, width], Grids::EdgesOnEdges));
        let evidence = lucas_kanade(EVIDENCE, first.clone(), warped.clone());
        let difference = space_to_depth((first.clone() - warped) * DIFFERENCE_SCALE, STRIDE);
        let seen = vec![still.clone(), difference, evidence.clone(), flow.clone(), state];
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
                    let seen = vec![state, map, flow.clone() - start.clone()];
                    (self.up[level].forward(concatenate(seen), LeakyRelu), flow)
                }
            };
            let predicted = self.predict[level].forward(state.clone(), Identity);
            let share = predicted.clone().narrow(1, 0, 1).tanh();
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
        let mut state = Tensor::zeros([batch, STATE, cells[0], cells[1]], &device);
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
            let mut found = self.corrected(frames, &still, [flow.detach(), state]);
            let finest = found.pop().expect("several sizes");
            if request.every_iteration {
                // Every second size is enough to teach the coarse maps.
                for Found { flow, mixture, .. } in found.into_iter().step_by(2) {
                    add(resize(flow, [height, width], Grids::EdgesOnEdges) * STRIDE as f64, mixture);
                }
            }
            if request.every_iteration || iteration == iterations {
                let found = self.upsampled(&finest);
                let found = if fine { self.finer(frames, found) } else { found };
                add(found, finest.mixture);
            }
            (flow, state) = (finest.flow, finest.state);
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
                let channels = LUMINANCE.iter().zip(frame.chunks_exact(width * height));
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
    avg_pool2d(x, AvgPoolOptions::new([2; 2]))
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
        let inner = |flow: &Tensor<4>| numbers(flow.clone().narrow(2, 8, 44).narrow(3, 8, 60));
        let distance = |flow: Vec<f32>, truth: [f32; 2]| {
            let (u, v) = flow.split_at(flow.len() / 2);
            let sum: f32 = u.iter().zip(v).map(|(u, v)| (u - truth[0]).hypot(v - truth[1])).sum();
            sum / u.len() as f32
        };
        // By default that of TV-L1.
        let found = network.forward(frames.clone(), &Request::new(2));
        let error = distance(inner(found.last()), [1.5, -0.75]);
        assert!(error < 0.2, "{error}");
        assert_eq!(found.coarse.expect("for a warm start").dims(), [1, 2, 32, 48]);
        // Or a given one, in cells.
        let start = Tensor::<1>::from_floats([2.0, 1.0], &Device::flex())
            .reshape([1, 2, 1, 1])
            .expand([1, 2, 32, 48]);
        let found = network.forward(frames, &Request { start: Some(start), ..Request::new(1) });
        let error = distance(inner(found.last()), [4.0, 2.0]);
        assert!(error < 1e-4, "{error}");
    }
}
