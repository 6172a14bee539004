//! UniMatch for flow (Xu et al., *Unifying Flow, Stereo and Depth Estimation*, TPAMI 2023): <https://arxiv.org/abs/2211.05783>,
//! also called GMFlow+. Self-attention and cross-attention enhance the features of both frames; a softmax over the correlations of
//! all pixels gives the flow, and self-attention of the first frame propagates it to pixels without a match. Optionally this is
//! repeated at a finer scale, and refined like in RAFT. Parity with the reference: `PARITY.md`.

use std::f64::consts::PI;

use burn::module::Module;
use burn::tensor::activation::{relu, softmax};
use burn::tensor::ops::PadMode;
use burn::tensor::{Device, Tensor, TensorData};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig, LayerNorm, Linear, LinearConfig, NoParameters};
use srflow_ops::Activation::{Gelu, Identity};
use srflow_ops::attention::Windows;
use srflow_ops::attention::tensor::attention;
use srflow_ops::concatenate;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::correlation::tensor::Correlation;
use srflow_ops::pointwise::tensor::pointwise_layers;
use srflow_ops::warp::tensor::warp;

use crate::blocks::{
    ConvexMask, Encoder, EncoderConfig, bilinear_upsample, convex_mask_by, unscaled_convex_upsample,
};
use crate::estimate::{Estimate, Request};
use crate::facts::{Facts, IterationPresets, Start, ptlflow};
use crate::features::Features;
use crate::frames::{Border, Frames};
use crate::iterations::Refinement;
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::raft::{HIDDEN, UpdateBlock};
use crate::recurrent::{Refined, pixel_grid, refine};
use crate::settings::{Allowed, Setting};

/// Channels of the features.
const CHANNELS: usize = 128;
/// Blocks of the transformer.
const BLOCKS: usize = 6;
/// Radius of the lookup window of a refinement.
const REFINEMENT_RADIUS: usize = 4;
/// Height and width of frames are padded to multiples of this.
const MULTIPLE: usize = 32;
/// Added to the variance by layer norms.
const EPSILON: f64 = 1e-5;
/// Mean and standard deviation of red, green and blue in ImageNet.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];
/// Added to the scores of positions outside of the image.
const OUTSIDE: f32 = -1e9;

pub(crate) const UNIMATCH: Entry<UniMatch> = Entry {
    facts: Facts {
        name: "unimatch",
        title: "UniMatch",
        paper: "https://arxiv.org/abs/2211.05783",
        parameters: 4_680_288,
        padding: MULTIPLE,
        start: Start::Frames("it matches all pixels of both frames"),
        trains: true,
        memory: MemoryNeed { fixed: 215_000_000, per_pixel: 360, attending: 0, most_weights: 0 },
        authors: "https://github.com/autonomousvision/unimatch",
        licence: "MIT",
        published: &[ptlflow!("unimatch", "things", "2433864a"), ptlflow!("unimatch", "mixdata", "9d7c1e4d")],
        ..Facts::DEFAULT
    },
    init: |device| UniMatch::new(vec![GLOBAL], false, device),
};

pub(crate) const UNIMATCH_SC2: Entry<UniMatch> = Entry {
    facts: Facts {
        name: "unimatch-sc2",
        title: "UniMatch (two scales)",
        parameters: 4_716_720,
        memory: MemoryNeed { fixed: 140_000_000, per_pixel: 850, attending: 0, most_weights: 0 },
        published: &[
            ptlflow!("unimatch_scale2", "things", "e75ae2f7"),
            ptlflow!("unimatch_scale2", "mixdata", "b514dde2"),
            ptlflow!("unimatch_scale2", "sintel", "f43b76ab"),
        ],
        ..UNIMATCH.facts
    },
    init: |device| UniMatch::new(vec![GLOBAL, LOCAL], false, device),
};

pub(crate) const UNIMATCH_SC2_REF6: Entry<UniMatch> = Entry {
    facts: Facts {
        name: "unimatch-sc2-ref6",
        title: "UniMatch (two scales, six refinements)",
        parameters: 7_360_688,
        iterations: IterationPresets { default: 6, authors: 6, training: 6 },
        published: &[
            ptlflow!("unimatch_scale2_refine6", "things", "54d7505b"),
            ptlflow!("unimatch_scale2_refine6", "mixdata", "398760b1"),
            ptlflow!("unimatch_scale2_refine6", "sintel", "95ab1410"),
            ptlflow!("unimatch_scale2_refine6", "kitti", "0626279a"),
        ],
        ..UNIMATCH_SC2.facts
    },
    init: |device| UniMatch::new(vec![GLOBAL, LOCAL], true, device),
};

/// Settings of a scale.
#[derive(Debug, Clone, Copy)]
struct Scale {
    /// Windows of the transformer's attention along each side.
    splits: usize,
    /// Largest displacement that is matched, in pixels of the scale; 0 for no limit.
    matching_radius: usize,
    /// Largest distance over which flow is propagated, in pixels of the scale; 0 for no limit.
    propagation_radius: usize,
}

/// The coarsest scale of the published networks.
const GLOBAL: Scale = Scale { splits: 2, matching_radius: 0, propagation_radius: 0 };
/// The finer one.
const LOCAL: Scale = Scale { splits: 8, matching_radius: 4, propagation_radius: 1 };

/// Name, description and allowed values of the settings of each scale. Its feature maps must divide evenly into the windows.
const SETTINGS: [[(&str, &str, Allowed); 3]; 2] = [
    [
        (
            "attn_splits_1",
            "windows of attention along each side at the coarsest scale (ptlflow's attn_splits_list)",
            Allowed::OneOf(&[1, 2, 4]),
        ),
        (
            "corr_radius_1",
            "radius of matching at the coarsest scale in its pixels, 0 for all pixels (corr_radius_list, there -1)",
            Allowed::Range(0..=16),
        ),
        (
            "prop_radius_1",
            "radius of the propagation of flow at the coarsest scale, 0 for all pixels (prop_radius_list, there -1)",
            Allowed::Range(0..=16),
        ),
    ],
    [
        ("attn_splits_2", "as attn_splits_1, at the finer scale", Allowed::OneOf(&[1, 2, 4, 8])),
        ("corr_radius_2", "as corr_radius_1, at the finer scale", Allowed::Range(0..=16)),
        ("prop_radius_2", "as prop_radius_1, at the finer scale", Allowed::Range(0..=16)),
    ],
];

/// UniMatch with one or two scales, with or without refinement.
#[derive(Module, Debug)]
pub struct UniMatch {
    backbone: Encoder,
    transformer: Transformer,
    feature_flow_attn: Propagation,
    /// Only in networks without refinement.
    upsampler: Option<ConvexMask>,
    refine_proj: Option<Conv2d>,
    refine: Option<UpdateBlock>,
    /// Coarsest first.
    #[module(skip)]
    scales: Vec<Scale>,
}

/// `FeatureTransformer`.
#[derive(Module, Debug)]
struct Transformer {
    layers: Vec<TransformerBlock>,
}

/// `TransformerBlock`.
#[derive(Module, Debug)]
struct TransformerBlock {
    self_attn: TransformerLayer,
    cross_attn_ffn: TransformerLayer,
}

/// `TransformerLayer`; only that of cross-attention has an MLP.
#[derive(Module, Debug)]
struct TransformerLayer {
    q_proj: Linear,
    k_proj: Linear,
    v_proj: Linear,
    merge: Linear,
    norm1: LayerNorm,
    mlp: Option<(Linear, NoParameters, Linear)>,
    norm2: Option<LayerNorm>,
}

/// `SelfAttnPropagation`: propagates flow between pixels with similar features.
#[derive(Module, Debug)]
struct Propagation {
    q_proj: Linear,
    k_proj: Linear,
}

impl UniMatch {
    fn new(scales: Vec<Scale>, refined: bool, device: &Device) -> Self {
        // Side of a pixel of the finest scale in pixels of the frame.
        let stride = if scales.len() > 1 { 4 } else { 8 };
        Self {
            backbone: EncoderConfig::of_scales(CHANNELS, scales.len()).init(device),
            transformer: Transformer { layers: (0..BLOCKS).map(|_| TransformerBlock::new(device)).collect() },
            feature_flow_attn: Propagation {
                q_proj: linear(CHANNELS, CHANNELS).init(device),
                k_proj: linear(CHANNELS, CHANNELS).init(device),
            },
            upsampler: (!refined).then(|| convex_mask_by(stride, 2 + CHANNELS, device)),
            refine_proj: refined.then(|| Conv2dConfig::new([CHANNELS, 2 * HIDDEN], [1, 1]).init(device)),
            refine: refined.then(|| UpdateBlock::new(window_side(REFINEMENT_RADIUS).pow(2), stride, device)),
            scales,
        }
    }

    /// Side of a pixel of the scale in pixels of the frame.
    fn stride(&self, scale: usize) -> usize {
        8 >> scale
    }

    /// Matches features of both frames at a scale, starting from the flow of the coarser scale.
    fn matched(&self, scale: usize, [first, second]: [Tensor<4>; 2], coarser: Option<Tensor<4>>) -> Matched {
        let Scale { splits, matching_radius, propagation_radius } = self.scales[scale];
        let start = coarser.map(|flow| bilinear_upsample(flow, 2).detach());
        let second = match &start {
            Some(flow) => warp(second, flow.clone()),
            None => second,
        };
        let [features, second] = self.transformer.forward(first, second, splits);
        let change = matching(features.clone(), second, matching_radius);
        let flow = match start {
            Some(start) => start + change,
            None => change,
        };
        let propagated = self.feature_flow_attn.forward(&features, flow.clone().detach(), propagation_radius);
        Matched { features, flows: [flow, propagated] }
    }
}

/// Output of a scale.
struct Matched {
    /// Features of the first frame after the transformer.
    features: Tensor<4>,
    /// Flow after matching, and after propagation.
    flows: [Tensor<4>; 2],
}

impl FlowNetwork for UniMatch {
    fn features(&self, frames: Tensor<4>) -> Features {
        let [batch, _, height, width] = frames.dims();
        let frames = standardized(frames, Border::new([height, width], MULTIPLE));
        Features::new(batch, self.backbone.forward_scales(frames))
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let border = Border::new(frames.size(), MULTIPLE);
        let [firsts, seconds] =
            request.features_of([frames.first, frames.second], Features::into_levels, |frames| {
                self.backbone.forward_scales(standardized(frames, border))
            });
        let mut flows = Vec::new();
        let mut iterations = None;
        let mut push = |fine: Tensor<4>| flows.push(border.remove(fine));
        let mut coarser = None;
        let last = self.scales.len() - 1;
        for (scale, pair) in firsts.into_iter().zip(seconds).map(<[_; 2]>::from).enumerate() {
            let stride = self.stride(scale);
            let to_refine = (scale == last && self.refine.is_some()).then(|| pair.clone());
            let Matched { features, flows: [matched, mut flow] } = self.matched(scale, pair, coarser.take());
            let upsampled = scale == last && self.upsampler.is_some();
            if request.every_iteration {
                push(bilinear_upsample(matched, stride));
                if !upsampled {
                    push(bilinear_upsample(flow.clone(), stride));
                }
            }
            if scale == last {
                if let Some(mask) = &self.upsampler {
                    let x = concatenate(vec![flow.clone(), features.clone()]);
                    push(unscaled_convex_upsample(mask, &x, flow.clone(), stride));
                }
                if let (Some(proj), Some(block @ UpdateBlock { mask: Some(mask), .. }), Some(pair)) =
                    (&self.refine_proj, &self.refine, to_refine)
                {
                    let start = proj.forward(features, Identity);
                    let mut refinement = request.refinement(request.iterations, border);
                    flow = refined(block, pair, start, flow, &mut refinement, |hidden, flow, (), last| {
                        if request.every_iteration || last {
                            push(unscaled_convex_upsample(mask, hidden, flow.clone(), stride));
                        }
                    });
                    iterations = Some(refinement.done());
                }
            }
            coarser = Some(flow);
        }
        Estimate { coarse: coarser, iterations, ..Estimate::of_flows(flows) }
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        let of_scale = |(scale, settings): (_, [(&'static str, &'static str, Allowed); 3])| {
            let Scale { splits, matching_radius, propagation_radius }: &mut Scale = scale;
            let values = [splits, matching_radius, propagation_radius];
            settings.into_iter().zip(values).map(|((name, description, allowed), value)| Setting {
                name,
                description,
                allowed,
                in_files: None,
                value,
            })
        };
        self.scales.iter_mut().zip(SETTINGS).flat_map(of_scale).collect()
    }
}

/// Flow after the refinements, all of which use the same hidden state (the first half of `start`) and context. See [`refine`].
fn refined(
    block: &UpdateBlock,
    [first, second]: [Tensor<4>; 2],
    start: Tensor<4>,
    flow: Tensor<4>,
    refinement: &mut Refinement,
    after: impl FnMut(&Tensor<4>, &Tensor<4>, (), bool),
) -> Tensor<4> {
    let correlation = Correlation::new(first, second, 1);
    let hidden = start.clone().narrow(1, 0, HIDDEN).tanh();
    let gru = block.gru.prepared(&relu(start.narrow(1, HIDDEN, HIDDEN)));
    let step = |_, flow, windows| {
        let hidden = gru.step(hidden.clone(), block.encoder.forward(flow, row_by_row(windows)));
        Refined { change: block.flow_head.forward(hidden.clone()), hidden, further: () }
    };
    let lookup = (&correlation, REFINEMENT_RADIUS);
    let [_, flow] = refine(lookup, refinement, [hidden.clone(), flow], step, after);
    flow
}

/// Reorders correlation windows, which are stored column by column as in RAFT, row by row.
fn row_by_row(windows: Tensor<4>) -> Tensor<4> {
    let dims @ [batch, entries, height, width] = windows.dims();
    let side = entries.isqrt();
    windows.reshape([batch, side, side, height * width]).swap_dims(1, 2).reshape(dims)
}

/// Entries per row of a window.
fn window_side(radius: usize) -> usize {
    2 * radius + 1
}

/// Frames normalized by ImageNet's mean and standard deviation, then padded.
fn standardized(frames: Tensor<4>, border: Border) -> Tensor<4> {
    let device = frames.device();
    let [mean, deviation] =
        [MEAN, DEVIATION].map(|rgb| Tensor::<1>::from_floats(rgb, &device).reshape([1, 3, 1, 1]));
    border.add((frames - mean) / deviation)
}

/// Flow by matching: for each pixel of the first map, the mean displacement to all pixels of the second, or to those within
/// `radius`, weighted by the softmax of their correlations.
fn matching(first: Tensor<4>, second: Tensor<4>, radius: usize) -> Tensor<4> {
    let [batch, channels, height, width] = first.dims();
    let grid = pixel_grid([batch, height, width], &first.device());
    if radius == 0 {
        let whole = Windows::split([height, width], 1);
        return attention(first * scale_of(channels), second, grid.clone(), &whole) - grid;
    }
    let scores = Correlation::new(first, second, 1).windows(grid, radius);
    let weights = softmax(inside(scores, radius), 1);
    let options = Conv2dOptions::new([1, 1], [0, 0]);
    let displacements = displacements(radius, &weights.device());
    conv2d(weights, displacements, Epilogue::default(), options)
}

/// Scale of attention scores.
fn scale_of(channels: usize) -> f64 {
    (channels as f64).powf(-0.5)
}

/// Lowers the scores of positions outside of the image, so that their softmax weights are zero.
fn inside(scores: Tensor<4>, radius: usize) -> Tensor<4> {
    let dims @ [batch, _, height, width] = scores.dims();
    let side = window_side(radius);
    // For each displacement along an axis, and each pixel.
    let outside = |len: usize| -> Vec<f32> {
        let at = |displacement: usize| (0..len).map(move |pixel| pixel + displacement);
        let inside = radius..radius + len;
        let score = |place: usize| if inside.contains(&place) { 0.0 } else { OUTSIDE };
        (0..side).flat_map(at).map(score).collect()
    };
    let device = scores.device();
    let columns = Tensor::from_data(TensorData::new(outside(width), [1, side, 1, width]), &device);
    let rows = Tensor::from_data(TensorData::new(outside(height), [1, 1, side * height, 1]), &device);
    (scores.reshape([batch, side, side * height, width]) + columns + rows).reshape(dims)
}

/// The displacement of each entry of a window, column by column, as the weight of a 1x1 convolution.
fn displacements(radius: usize, device: &Device) -> Tensor<4> {
    let side = window_side(radius);
    let along = |i: usize| i as f32 - radius as f32;
    let of_entries = |of: fn(usize, usize) -> usize| (0..side * side).map(move |i| along(of(i, side)));
    let values: Vec<f32> = of_entries(|i, side| i / side).chain(of_entries(|i, side| i % side)).collect();
    Tensor::from_data(TensorData::new(values, [2, side * side, 1, 1]), device)
}

fn linear(inputs: usize, outputs: usize) -> LinearConfig {
    LinearConfig::new(inputs, outputs).with_initializer(Initializer::XavierUniform { gain: 1.0 })
}

impl Transformer {
    /// Features of both frames after self-attention and cross-attention in windows, `splits` along each side.
    fn forward(&self, first: Tensor<4>, second: Tensor<4>, splits: usize) -> [Tensor<4>; 2] {
        let [batch, _, height, width] = first.dims();
        let places = positions([height, width], splits, &first.device());
        let mut both = Tensor::cat(vec![first, second], 0) + places;
        let whole = Windows::split([height, width], splits);
        let moved = if splits > 1 { Windows::shifted([height, width], splits) } else { whole.clone() };
        for (number, layer) in self.layers.iter().enumerate() {
            both = layer.forward(both, if number % 2 == 0 { &whole } else { &moved });
        }
        [both.clone().narrow(0, 0, batch), both.narrow(0, batch, batch)]
    }
}

/// Sine embedding of the position within its window (`PositionEmbeddingSine`), `[1, CHANNELS, height, width]`: half of the channels
/// for the row, half for the column.
fn positions([height, width]: [usize; 2], splits: usize, device: &Device) -> Tensor<4> {
    let along = |len: usize| -> Vec<f32> {
        let window = len / splits;
        let wave = |channel: usize, at: usize| {
            let place = (at % window + 1) as f64 / (window as f64 + 1e-6) * 2.0 * PI;
            let angle = place / 1e4_f64.powf((channel / 2 * 2) as f64 / (CHANNELS / 2) as f64);
            if channel.is_multiple_of(2) { angle.sin() } else { angle.cos() }
        };
        let of_channel = |channel| (0..len).map(move |at| wave(channel, at) as f32);
        (0..CHANNELS / 2).flat_map(of_channel).collect()
    };
    let half = CHANNELS / 2;
    let by_row = Tensor::<4>::from_data(TensorData::new(along(height), [1, half, height, 1]), device);
    let by_column = Tensor::<4>::from_data(TensorData::new(along(width), [1, half, 1, width]), device);
    let whole = [1, half, height, width];
    concatenate(vec![by_row.expand(whole), by_column.expand(whole)])
}

impl TransformerBlock {
    fn new(device: &Device) -> Self {
        Self {
            self_attn: TransformerLayer::new(false, device),
            cross_attn_ffn: TransformerLayer::new(true, device),
        }
    }

    /// Features of the first frames, followed by those of the second.
    fn forward(&self, both: Tensor<4>, windows: &Windows) -> Tensor<4> {
        let batch = both.dims()[0] / 2;
        let others = vec![both.clone().narrow(0, batch, batch), both.clone().narrow(0, 0, batch)];
        let both = self.self_attn.forward(both.clone(), both, windows);
        self.cross_attn_ffn.forward(both, Tensor::cat(others, 0), windows)
    }
}

impl TransformerLayer {
    fn new(with_mlp: bool, device: &Device) -> Self {
        let plain = |inputs, outputs| linear(inputs, outputs).with_bias(false).init(device);
        let square = || plain(CHANNELS, CHANNELS);
        let norm = || LayerNorm::new(CHANNELS, EPSILON, device);
        let wide = 4 * 2 * CHANNELS;
        Self {
            q_proj: square(),
            k_proj: square(),
            v_proj: square(),
            merge: square(),
            norm1: norm(),
            mlp: with_mlp.then(|| (plain(2 * CHANNELS, wide), NoParameters, plain(wide, CHANNELS))),
            norm2: with_mlp.then(norm),
        }
    }

    fn forward(&self, x: Tensor<4>, attended: Tensor<4>, windows: &Windows) -> Tensor<4> {
        let queries = self.q_proj.forward_pixels(x.clone(), Identity) * scale_of(CHANNELS);
        let keys = self.k_proj.forward_pixels(attended.clone(), Identity);
        let values = self.v_proj.forward_pixels(attended, Identity);
        let message = self.merge.forward_pixels(attention(queries, keys, values, windows), Identity);
        match (&self.mlp, &self.norm2) {
            (Some((widen, _, narrow)), Some(norm)) => {
                let message = concatenate(vec![x.clone(), self.norm1.forward(message)]);
                let message = pointwise_layers(message, [widen.layer(Gelu), narrow.layer(Identity)]);
                norm.forward_add(message, x)
            }
            _ => self.norm1.forward_add(message, x),
        }
    }
}

impl Propagation {
    /// The mean flow of all pixels, or of those within `radius`, weighted by the softmax of the similarity of features.
    fn forward(&self, features: &Tensor<4>, flow: Tensor<4>, radius: usize) -> Tensor<4> {
        let [batch, channels, height, width] = features.dims();
        let queries = self.q_proj.forward_pixels(features.clone(), Identity);
        if radius == 0 {
            // The reference computes keys from the queries here, and the published weights were trained that way.
            let keys = self.k_proj.forward_pixels(queries.clone(), Identity);
            let whole = Windows::split([height, width], 1);
            return attention(queries * scale_of(channels), keys, flow, &whole);
        }
        let keys = self.k_proj.forward_pixels(features.clone(), Identity);
        let grid = pixel_grid([batch, height, width], &features.device());
        let weights = softmax(Correlation::new(queries, keys, 1).windows(grid, radius), 1);
        // Outside of the image, keys and flow are zero, but weights are not.
        let padded = flow.pad((radius, radius, radius, radius), PadMode::Constant(0.0));
        let side = window_side(radius);
        let weighted = (0..side * side).map(|entry| {
            let neighbour = padded.clone().narrow(2, entry % side, height).narrow(3, entry / side, width);
            weights.clone().narrow(1, entry, 1) * neighbour
        });
        weighted.reduce(|sum, more| sum + more).unwrap_or(padded)
    }
}
