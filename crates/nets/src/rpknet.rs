//! RPKNet (Morimitsu et al., *Recurrent Partial Kernel Network for Efficient Optical Flow Estimation*, AAAI 2024). A recurrent
//! encoder computes all levels of a feature pyramid with parts of the same kernels, and flow is refined from the coarsest level to
//! the finest. Parity with the reference: `PARITY.md`.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig};
use srflow_ops::Activation::{self, Gelu, Identity, Relu, Sigmoid, Tanh};
use srflow_ops::activation::tensor::activated_sum;
use srflow_ops::concatenate;
use srflow_ops::conv2d::tensor::Epilogue;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::instance_norm::tensor::group_norm;
use srflow_ops::layer_norm::tensor::layer_norm;

use crate::blocks::level::{Depthwise, Level, MOTION, RADIUS, Transition, UpdateBlock};
use crate::blocks::{ConvGru, Grids, resize, resize_flow, upsample_by};
use crate::estimate::{Estimate, Request};
use crate::facts::{Facts, IterationPresets, Start, ptlflow};
use crate::features::Features;
use crate::frames::Frames;
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::recurrent::{Refined, STRIDE, refine};
use crate::settings::{Allowed, Setting};

/// Levels of the pyramid at which flow is refined.
const LEVELS: usize = 3;
/// Side of a pixel of the coarsest level in pixels of the frame.
const COARSEST_STRIDE: usize = STRIDE << (LEVELS - 1);
/// Input and output channels of the encoder's hidden state at each of its steps, each of which halves the size.
const STEPS: [[usize; 2]; 4] = [[32, 64], [64, 96], [96, 96], [96, 96]];
/// Most channels of the encoder.
const WIDEST: usize = 96;
/// Channels of a level: the first two thirds are matched, the rest is context.
const FEATURES: usize = 2 * WIDEST;
/// Channels of the hidden state of the refinement, and of the context.
const HIDDEN: usize = 64;
/// Length of the two strips of a separable large kernel.
const LONG: usize = 23;
/// Initial layer scale of every branch of a block.
const LAYER_SCALE: f64 = 1e-2;
/// Added to the variance by norms.
const EPSILON: f64 = 1e-6;
/// Groups of the group norms that the published weights were trained with.
const GROUPS: usize = 8;

pub(crate) const RPKNET: Entry<RpkNet> = Entry {
    facts: Facts {
        name: "rpknet",
        title: "RPKNet",
        paper: "https://doi.org/10.1609/aaai.v38i5.28224",
        parameters: 2_846_624,
        padding: COARSEST_STRIDE,
        smallest_side: 2 * COARSEST_STRIDE,
        iterations: IterationPresets { default: 12, authors: 32, training: 12 },
        start: Start::CoarsestLevel,
        trains: true,
        memory: MemoryNeed { fixed: 240_000_000, per_pixel: 315, attending: 0, most_weights: 0 },
        authors: "https://github.com/hmorimitsu/ptlflow",
        licence: "Apache-2.0; weights for research only",
        published: &[
            ptlflow!("rpknet", "chairs", "a705b345"),
            ptlflow!("rpknet", "things", "f79b0d81"),
            ptlflow!("rpknet", "sintel", "e7cc969e"),
            ptlflow!("rpknet", "kitti", "39504eb4"),
        ],
        ..Facts::DEFAULT
    },
    init: RpkNet::new,
};

#[derive(Module, Debug)]
pub struct RpkNet {
    fnet: Encoder,
    update_block: UpdateBlock<Stage>,
    upnet_gate_layer: UpGate,
    groups: usize,
}

/// `PKConvSLKEncoder`.
#[derive(Module, Debug)]
struct Encoder {
    stem: [Conv2d; 1],
    forward_gru: ConvGru,
    down_gru: Conv2d,
    rec_stage: Stage,
    out_1x1: Conv2d,
}

/// `PKConvSLK`.
#[derive(Module, Debug)]
struct Stage {
    down: Transition,
    blocks: Vec<Block>,
}

/// `SLK`: a large kernel in two strips, then an MLP, both residual.
#[derive(Module, Debug)]
struct Block {
    layer_scale_1: Param<Tensor<1>>,
    layer_scale_2: Param<Tensor<1>>,
    attn: Strips,
    mlp: Perceptron,
}

/// `SLKUnit`.
#[derive(Module, Debug)]
struct Strips {
    proj_1: Conv2d,
    spatial_gating_unit: StripsCore,
    proj_2: Conv2d,
}

/// `SLKUnitCore`.
#[derive(Module, Debug)]
struct StripsCore {
    conv1_branches: [Conv2d; 1],
    conv2_branches: [Conv2d; 1],
    conv_out: Conv2d,
}

/// `Mlp`.
#[derive(Module, Debug)]
struct Perceptron {
    fc1: Conv2d,
    dwconv: Depthwise,
    fc2: Conv2d,
}

/// `UpNetPartial`: gates the hidden state of the coarser level.
#[derive(Module, Debug)]
struct UpGate {
    conv: Conv2d,
    res: Residual,
}

/// `ResidualPartialBlock`, without the options that the network does not use.
#[derive(Module, Debug)]
struct Residual {
    conv1: Conv2d,
    conv2: Conv2d,
}

/// Group norm or layer norm, without learned scale.
#[derive(Debug, Clone, Copy)]
enum Norm {
    /// Over the pixels of each of this many groups of channels.
    Groups(usize),
    /// Over the channels of each pixel.
    Layer,
}

impl Norm {
    /// `activation(norm(x))`.
    fn of(self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        match self {
            Self::Groups(groups) => group_norm(x, groups, EPSILON, activation),
            Self::Layer => layer_norm(x, EPSILON, activation),
        }
    }
}

impl RpkNet {
    pub(crate) fn new(device: &Device) -> Self {
        let conv = |channels, kernel| Conv2dConfig::new(channels, [kernel; 2]);
        let gate = || Stage::new([HIDDEN + HIDDEN + MOTION, HIDDEN], 1, device);
        Self {
            fnet: Encoder {
                stem: [conv([3, STEPS[0][0]], 7).with_stride(2).init(device)],
                forward_gru: ConvGru::new(WIDEST, WIDEST, device),
                down_gru: conv([WIDEST, WIDEST], 3).with_stride(2).init(device),
                rec_stage: Stage::new([WIDEST, WIDEST], 2, device),
                out_1x1: conv([WIDEST, FEATURES], 1).init(device),
            },
            update_block: UpdateBlock::new(HIDDEN, 2, gate, 2, device),
            upnet_gate_layer: UpGate {
                conv: conv([2 * HIDDEN, HIDDEN], 1).init(device),
                res: Residual {
                    conv1: conv([HIDDEN, HIDDEN], 3).init(device),
                    conv2: conv([HIDDEN, HIDDEN], 3).init(device),
                },
            },
            groups: GROUPS,
        }
    }

    fn norm(&self) -> Norm {
        Norm::Groups(self.groups)
    }

    /// Feature maps of padded frames in -1..1, coarsest level first.
    fn pyramid(&self, frames: Tensor<4>) -> Vec<Tensor<4>> {
        // The reference was trained with BGR.
        self.fnet.forward(frames.flip([1]), self.norm())
    }
}

impl FlowNetwork for RpkNet {
    fn features(&self, frames: Tensor<4>) -> Features {
        Features::of_prepared(frames, COARSEST_STRIDE, |frames| self.pyramid(frames))
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let (first, second, border) = frames.prepared(COARSEST_STRIDE);
        let [batch, _, height, width] = first.dims();
        let [firsts, seconds] =
            request.features_of([first, second], Features::into_levels, |frames| self.pyramid(frames));
        let of_level = request.iterations.div_ceil(LEVELS);
        let mut iterations = 0;
        let mut flows = Vec::new();
        let mut coarser: Option<[Tensor<4>; 2]> = None;
        for (number, (first, second)) in firsts.into_iter().zip(seconds).enumerate() {
            let finest = number + 1 == LEVELS;
            let stride = COARSEST_STRIDE >> number;
            let size = [height / stride, width / stride];
            let Level { correlation, context, hidden } = Level::new(first, second);
            let start = match coarser {
                Some([state, flow]) => [
                    self.upnet_gate_layer.forward(state, hidden, self.norm()),
                    resize_flow(flow, size, Grids::CornersOnCorners),
                ],
                None => {
                    let flow = request.start_flow(batch, size, &hidden.device());
                    [hidden, flow]
                }
            };
            let step = |hidden, flow, windows| {
                let sum = |stage: &Stage, x, activation| stage.forward(x, HIDDEN, Norm::Layer, activation);
                let [hidden, change] = self.update_block.step(hidden, &context, [flow, windows], sum);
                Refined { hidden, change, further: () }
            };
            let mut refinement = request.refinement(of_level, border);
            let lookup = (&correlation, RADIUS);
            coarser = Some(refine(lookup, &mut refinement, start, step, |hidden, flow, (), last| {
                if request.every_iteration || (finest && last) {
                    let fine = if finest {
                        upsample_by(&self.update_block.mask.weights(hidden), flow.clone())
                    } else {
                        resize_flow(flow.clone(), [height, width], Grids::CornersOnCorners)
                    };
                    flows.push(border.remove(fine));
                }
            }));
            iterations += refinement.done();
        }
        let coarsest = [height / COARSEST_STRIDE, width / COARSEST_STRIDE];
        Estimate {
            coarse: coarser.map(|[_, flow]| resize_flow(flow, coarsest, Grids::CornersOnCorners)),
            iterations: Some(iterations),
            ..Estimate::of_flows(flows)
        }
    }

    fn levels(&self, _: [usize; 2]) -> Option<usize> {
        Some(LEVELS)
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![Setting {
            name: "groups",
            description: "groups of the encoder's group norms; not stored in weights. The default is that of ptlflow and its \
                          weights (its training configurations have 4)",
            allowed: Allowed::OneOf(&[1, 2, 4, 8, 16, 32]),
            in_files: None,
            value: &mut self.groups,
        }]
    }
}

impl Encoder {
    fn forward(&self, frames: Tensor<4>, norm: Norm) -> Vec<Tensor<4>> {
        let [stem] = &self.stem;
        let mut x = norm.of(stem.forward(frames, Identity), Identity);
        let mut hidden = None;
        let mut levels = Vec::with_capacity(LEVELS);
        for (number, [_, outputs]) in STEPS.into_iter().enumerate() {
            let state = self.forward_gru.step(hidden, x);
            x = self.rec_stage.forward(state.clone(), outputs, norm, Identity);
            let last = number + 1 == STEPS.len();
            hidden = (!last).then(|| self.down_gru.partial(state, outputs, Epilogue::with(Tanh)));
            if number + LEVELS >= STEPS.len() {
                levels.push(self.out_1x1.partial(x.clone(), FEATURES, Epilogue::default()));
            }
        }
        levels.reverse();
        levels
    }
}

impl UpGate {
    /// Combines the hidden state of the coarser level with that of a level.
    fn forward(&self, coarser: Tensor<4>, own: Tensor<4>, norm: Norm) -> Tensor<4> {
        let [_, _, height, width] = own.dims();
        let coarser = resize(coarser, [height, width], Grids::CornersOnCorners).tanh();
        let x = self.conv.forward(concatenate(vec![coarser.clone(), own.clone()]), Relu);
        let y = norm.of(self.res.conv1.forward(x.clone(), Identity), Relu);
        let y = norm.of(self.res.conv2.forward(y, Identity), Identity);
        let gate = activated_sum(x, y, Sigmoid);
        own.clone() + gate * (coarser - own)
    }
}

impl Stage {
    fn new(channels @ [_, outputs]: [usize; 2], stride: usize, device: &Device) -> Self {
        let kernel = if stride > 1 { [3, 3] } else { [1, 1] };
        let proj = Conv2dConfig::new(channels, kernel).with_stride(stride).init(device);
        let block = |_| Block::new(outputs, device);
        Self { down: Transition { proj }, blocks: (0..2).map(block).collect() }
    }

    /// Applies the stage with the first `outputs` output channels, then the activation.
    fn forward(&self, x: Tensor<4>, outputs: usize, norm: Norm, activation: Activation) -> Tensor<4> {
        let mut x = norm.of(self.down.proj.partial(x, outputs, Epilogue::default()), Identity);
        for block in &self.blocks {
            x = block.forward(x, norm);
        }
        norm.of(x, activation)
    }
}

impl Block {
    fn new(channels: usize, device: &Device) -> Self {
        let pointwise = |inputs, outputs| Conv2dConfig::new([inputs, outputs], [1, 1]).init(device);
        let depthwise =
            |channels, kernel| Conv2dConfig::new([channels; 2], kernel).with_depthwise(true).init(device);
        let scale = || Initializer::Constant { value: LAYER_SCALE }.init([channels], device);
        let wide = 4 * channels;
        Self {
            layer_scale_1: scale(),
            layer_scale_2: scale(),
            attn: Strips {
                proj_1: pointwise(channels, channels),
                spatial_gating_unit: StripsCore {
                    conv1_branches: [depthwise(channels, [LONG, 1])],
                    conv2_branches: [depthwise(channels, [1, LONG])],
                    conv_out: pointwise(channels, channels),
                },
                proj_2: pointwise(channels, channels),
            },
            mlp: Perceptron {
                fc1: pointwise(channels, wide),
                dwconv: Depthwise { dwconv: depthwise(wide, [3, 3]) },
                fc2: pointwise(wide, channels),
            },
        }
    }

    fn forward(&self, x: Tensor<4>, norm: Norm) -> Tensor<4> {
        let strips = self.attn.forward(norm.of(x.clone(), Identity));
        let x = add_scaled(x, strips, &self.layer_scale_1);
        let perceptron = self.mlp.forward(norm.of(x.clone(), Identity));
        add_scaled(x, perceptron, &self.layer_scale_2)
    }
}

/// `x + scale * branch`, with the first factors of `scale` as factors of the channels.
fn add_scaled(x: Tensor<4>, branch: Tensor<4>, scale: &Param<Tensor<1>>) -> Tensor<4> {
    let channels = x.dims()[1];
    let scale = scale.val().narrow(0, 0, channels).reshape([channels, 1, 1, 1]);
    depthwise(branch, scale, Epilogue::default().residual(x), [0, 0])
}

impl Strips {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let channels = x.dims()[1];
        let plus = |conv: &Conv2d, y: Tensor<4>, added: &Tensor<4>| {
            conv.partial(y, channels, Epilogue::default().residual(added.clone()))
        };
        let StripsCore { conv1_branches: [down], conv2_branches: [across], conv_out } =
            &self.spatial_gating_unit;
        let inner = self.proj_1.partial(x.clone(), channels, Epilogue::with(Gelu));
        let y = plus(down, inner.clone(), &inner);
        let y = plus(across, y.clone(), &y);
        plus(&self.proj_2, plus(conv_out, y, &inner), &x)
    }
}

impl Perceptron {
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let channels = x.dims()[1];
        let x = self.fc1.partial(x, 4 * channels, Epilogue::default());
        let x = self.dwconv.dwconv.partial(x, 4 * channels, Epilogue::with(Gelu));
        self.fc2.partial(x, channels, Epilogue::default())
    }
}
