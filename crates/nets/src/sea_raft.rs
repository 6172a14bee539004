//! SEA-RAFT (Wang, Lipson and Deng, ECCV 2024): <https://arxiv.org/abs/2405.14793>. RAFT that regresses an initial flow from both
//! frames, refines it with ConvNeXt blocks, and predicts a mixture of Laplace distributions of its error. Parity with the
//! reference: `PARITY.md`.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{BatchNorm, Conv2d, Conv2dConfig, LayerNorm, Linear, LinearConfig, NoParameters};
use srflow_ops::Activation::{Gelu, Identity, Relu};
use srflow_ops::WeightCache;
use srflow_ops::activation::tensor::activated_sum;
use srflow_ops::concatenate;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::correlation::tensor::Correlation;

use crate::blocks::{ConvexMask, MotionEncoder, convex_mask, convex_upsample};
use crate::estimate::{Encoded, Estimate, LaplaceMixture, Request};
use crate::facts::{Facts, IterationPresets, Start, ptlflow};
use crate::features::Features;
use crate::frames::{Border, Frames};
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};
use crate::raft::{HIDDEN, RADIUS};
use crate::recurrent::{LEVELS, Refined, STRIDE, refine};

/// Channels of the context, and of the motion features.
const CONTEXT: usize = HIDDEN;
/// Blocks that update the hidden state in each iteration.
const BLOCKS: usize = 2;
/// Channels of the encoders at 1/2, 1/4 and 1/8 of the size.
const WIDTHS: [usize; 3] = [64, 128, 256];
/// Residual blocks at each of these sizes, in ResNet-18 and ResNet-34.
const RESNET18: [usize; 3] = [2, 2, 2];
const RESNET34: [usize; 3] = [3, 4, 6];
/// Added to the variance in the layer norm of ConvNeXt.
const EPSILON: f64 = 1e-6;
/// Initial layer scale of ConvNeXt blocks.
const LAYER_SCALE: f64 = 1e-6;

pub(crate) const SEA_RAFT_S: Entry<SeaRaft> = Entry {
    facts: Facts {
        name: "sea-raft-s",
        title: "SEA-RAFT (S)",
        paper: "https://arxiv.org/abs/2405.14793",
        parameters: 8_883_460,
        padding: STRIDE,
        smallest_side: 128,
        iterations: IterationPresets { default: 4, authors: 4, training: 4 },
        start: Start::Frames("it computes its initial flow from the frames"),
        recompute: true,
        trains: true,
        mixture: true,
        memory: MemoryNeed { fixed: 255_000_000, per_pixel: 365, attending: 0, most_weights: 0 },
        authors: "https://github.com/princeton-vl/SEA-RAFT",
        licence: "BSD-3-Clause",
        renamed: |name| Some(name.replacen(".bn3.", ".downsample.1.", 1)),
        published: &[
            ptlflow!("sea_raft_s", "tartan", "f7e26f21"),
            ptlflow!("sea_raft_s", "chairs", "6980249f"),
            ptlflow!("sea_raft_s", "things", "a15c1713"),
            ptlflow!("sea_raft_s", "sintel", "bb63371a"),
            ptlflow!("sea_raft_s", "kitti", "3a96c1cc"),
            ptlflow!("sea_raft_s", "spring", "4d13c106"),
        ],
        ..Facts::DEFAULT
    },
    init: |device| SeaRaft::new(RESNET18, device),
};

pub(crate) const SEA_RAFT_M: Entry<SeaRaft> = Entry {
    facts: Facts {
        name: "sea-raft-m",
        title: "SEA-RAFT (M)",
        parameters: 19_663_876,
        same_weights: &["sea-raft-l"],
        published: &[
            ptlflow!("sea_raft_m", "tartan", "e684ed5f"),
            ptlflow!("sea_raft_m", "chairs", "1cb7b11e"),
            ptlflow!("sea_raft_m", "things", "ac45dd7f"),
            ptlflow!("sea_raft_m", "sintel", "f8bb7e3f"),
            ptlflow!("sea_raft_m", "kitti", "e51f7603"),
            ptlflow!("sea_raft_m", "spring", "de7c13e2"),
        ],
        ..SEA_RAFT_S.facts
    },
    init: |device| SeaRaft::new(RESNET34, device),
};

/// SEA-RAFT (M) with more iterations.
pub(crate) const SEA_RAFT_L: Entry<SeaRaft> = Entry {
    facts: Facts {
        name: "sea-raft-l",
        title: "SEA-RAFT (L)",
        iterations: IterationPresets { default: 12, authors: 12, training: 4 },
        same_weights: &["sea-raft-m"],
        ..SEA_RAFT_M.facts
    },
    init: SEA_RAFT_M.init,
};

/// SEA-RAFT of any size.
#[derive(Module, Debug)]
pub struct SeaRaft {
    cnet: Encoder,
    init_conv: Conv2d,
    upsample_weight: ConvexMask,
    /// Outputs the change of the flow, log weights and log scales, 2 channels each.
    flow_head: (Conv2d, NoParameters, Conv2d),
    fnet: Encoder,
    update_block: UpdateBlock,
}

#[derive(Module, Debug)]
struct UpdateBlock {
    encoder: MotionEncoder,
    refine: Vec<ConvNextBlock>,
}

/// `ConvNextBlock`.
#[derive(Module, Debug)]
struct ConvNextBlock {
    dwconv: Conv2d,
    norm: LayerNorm,
    pwconv1: Linear,
    pwconv2: Linear,
    gamma: Param<Tensor<1>>,
    r#final: Conv2d,
}

/// `ResNetFPN`: a ResNet without its last stage, which reduces the size to an eighth.
#[derive(Module, Debug)]
struct Encoder {
    conv1: Conv2d,
    bn1: BatchNorm,
    layer1: Vec<ResidualBlock>,
    layer2: Vec<ResidualBlock>,
    layer3: Vec<ResidualBlock>,
    final_conv: Conv2d,
}

/// `BasicBlock`. For blocks that halve the size, the reference stores the norm of the shortcut twice: as `downsample.1` and as
/// `bn3`.
#[derive(Module, Debug)]
struct ResidualBlock {
    conv1: Conv2d,
    bn1: BatchNorm,
    conv2: Conv2d,
    bn2: BatchNorm,
    downsample: Option<(Conv2d, BatchNorm)>,
}

impl SeaRaft {
    fn new(blocks: [usize; 3], device: &Device) -> Self {
        let conv = |inputs, outputs| Conv2dConfig::new([inputs, outputs], [3, 3]).init(device);
        Self {
            cnet: Encoder::new(6, HIDDEN + CONTEXT, blocks, device),
            init_conv: conv(HIDDEN + CONTEXT, HIDDEN + CONTEXT),
            upsample_weight: convex_mask(HIDDEN, device),
            flow_head: (conv(HIDDEN, 2 * HIDDEN), NoParameters, conv(2 * HIDDEN, 6)),
            fnet: Encoder::new(3, 2 * HIDDEN, blocks, device),
            update_block: UpdateBlock {
                encoder: MotionEncoder::new(RADIUS, device),
                refine: (0..BLOCKS).map(|_| ConvNextBlock::new(HIDDEN, device)).collect(),
            },
        }
    }

    /// The initial hidden state, and the context, which is constant over the iterations.
    fn hidden_and_context(&self, first: Tensor<4>, second: Tensor<4>) -> [Tensor<4>; 2] {
        let both = self.cnet.forward(concatenate(vec![first, second]));
        let both = self.init_conv.forward(both, Identity);
        [both.clone().narrow(1, 0, HIDDEN), both.narrow(1, HIDDEN, CONTEXT)]
    }

    /// The change of the flow in coarse pixels, and the mixture: log weights, then log scales, `[batch, 4, height, width]`.
    fn change(&self, hidden: Tensor<4>) -> [Tensor<4>; 2] {
        let change = self.flow_head.2.forward(self.flow_head.0.forward(hidden, Relu), Identity);
        [change.clone().narrow(1, 0, 2), change.narrow(1, 2, 4)]
    }

    /// Adds the flow and its mixture to the estimate, upsampled.
    fn push_upsampled(
        &self,
        estimate: &mut Estimate,
        hidden: &Tensor<4>,
        [flow, mixture]: [Tensor<4>; 2],
        border: Border,
    ) {
        let fine = |flow| border.remove(convex_upsample(&self.upsample_weight, hidden, flow));
        let part = |first| fine(mixture.clone().narrow(1, first, 2) / STRIDE as f64);
        estimate.flows.push(fine(flow));
        estimate.mixtures.push(LaplaceMixture { log_weights: part(0), log_scales: part(2) });
    }
}

impl FlowNetwork for SeaRaft {
    fn features(&self, frames: Tensor<4>) -> Features {
        Features::of_prepared(frames, STRIDE, |frames| vec![self.fnet.forward(frames)])
    }

    fn encode(&self, frames: Frames) -> Option<Encoded> {
        let (first, second, _) = frames.prepared(STRIDE);
        let [hidden, context] = self.hidden_and_context(first.clone(), second.clone());
        Some(Encoded { hidden, constant: vec![context, self.fnet.forward(first), self.fnet.forward(second)] })
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let (first, second, border) = frames.prepared(STRIDE);
        let (hidden, context, [first, second]) = match &request.encoded {
            Some(encoded) => encoded.of_pair(),
            None => {
                let [hidden, context] = self.hidden_and_context(first.clone(), second.clone());
                let features = request
                    .features_of([first, second], Features::into_map, |frames| self.fnet.forward(frames));
                (hidden, context, features)
            }
        };
        let correlation = Correlation::new(first, second, LEVELS);
        let mut estimate = Estimate::of_flows(Vec::new());
        let flow = match &request.start {
            Some(start) => start.clone(),
            None => {
                let [flow, mixture] = self.change(hidden.clone());
                if request.every_iteration {
                    self.push_upsampled(&mut estimate, &hidden, [flow.clone(), mixture], border);
                }
                flow
            }
        };
        let step = |hidden, flow, windows| {
            let hidden = self.update_block.forward(hidden, &context, flow, windows);
            let [change, mixture] = self.change(hidden.clone());
            Refined { hidden, change, further: mixture }
        };
        let mut refinement = request.refinement(request.iterations, border);
        let [hidden, flow] = refine(
            (&correlation, RADIUS),
            &mut refinement,
            [hidden, flow],
            step,
            |hidden, flow, mixture, last| {
                if request.every_iteration || last {
                    self.push_upsampled(&mut estimate, hidden, [flow.clone(), mixture], border);
                }
            },
        );
        let iterations = Some(refinement.done());
        Estimate { coarse: Some(flow), hidden: Some(hidden), iterations, ..estimate }
    }
}

impl UpdateBlock {
    /// The next hidden state.
    fn forward(
        &self,
        hidden: Tensor<4>,
        context: &Tensor<4>,
        flow: Tensor<4>,
        windows: Tensor<4>,
    ) -> Tensor<4> {
        let motion = self.encoder.forward(flow, windows);
        self.refine.iter().fold(hidden, |hidden, block| {
            block.forward(concatenate(vec![hidden, context.clone(), motion.clone()]))
        })
    }
}

impl ConvNextBlock {
    fn new(hidden: usize, device: &Device) -> Self {
        let inputs = hidden + 2 * CONTEXT;
        Self {
            dwconv: Conv2dConfig::new([inputs, inputs], [7, 7]).with_depthwise(true).init(device),
            norm: LayerNorm::new(inputs, EPSILON, device),
            pwconv1: LinearConfig::new(inputs, 4 * hidden).init(device),
            pwconv2: LinearConfig::new(4 * hidden, inputs).init(device),
            gamma: Initializer::Constant { value: LAYER_SCALE }.init([inputs], device),
            r#final: Conv2dConfig::new([inputs, hidden], [1, 1]).init(device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = self.norm.forward(self.dwconv.forward(x.clone(), Identity));
        let y = self.pwconv1.forward_pixels(y, Gelu);
        let gamma = self.gamma.val();
        let channels = gamma.dims()[0];
        let kernel = self.pwconv2.kernel() * gamma.clone().reshape([channels, 1, 1, 1]);
        let bias = self.pwconv2.bias().map(|bias| bias * gamma);
        let epilogue = Epilogue::default().bias(bias).residual(x);
        let options = Conv2dOptions { stride: [1, 1], padding: [0, 0], cache: WeightCache::default() };
        self.r#final.forward(conv2d(y, kernel, epilogue, options), Identity)
    }
}

fn conv(channels: [usize; 2], kernel: usize, stride: usize, device: &Device) -> Conv2d {
    Conv2dConfig::new(channels, [kernel; 2])
        .with_stride(stride)
        .with_initializer(Initializer::KaimingNormal { gain: std::f64::consts::SQRT_2, fan_out_only: true })
        .with_bias_initializer(Initializer::Zeros)
        .init(device)
}

impl Encoder {
    fn new(inputs: usize, outputs: usize, blocks: [usize; 3], device: &Device) -> Self {
        let layer = |stage: usize| -> Vec<ResidualBlock> {
            let (before, width) = (WIDTHS[stage.saturating_sub(1)], WIDTHS[stage]);
            let block = |number| {
                let first = number == 0;
                let channels = [if first { before } else { width }, width];
                ResidualBlock::new(channels, if first && stage > 0 { 2 } else { 1 }, device)
            };
            (0..blocks[stage]).map(block).collect()
        };
        Self {
            conv1: conv([inputs, WIDTHS[0]], 7, 2, device),
            bn1: BatchNorm::new(WIDTHS[0], device),
            layer1: layer(0),
            layer2: layer(1),
            layer3: layer(2),
            final_conv: conv([WIDTHS[2], outputs], 1, 1, device),
        }
    }

    /// `[batch, outputs, height / 8, width / 8]` from `[batch, inputs, height, width]`.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let mut x = self.bn1.after(&self.conv1, x, Relu);
        for block in self.layer1.iter().chain(&self.layer2).chain(&self.layer3) {
            x = block.forward(x);
        }
        self.final_conv.forward(x, Identity)
    }
}

impl ResidualBlock {
    fn new([inputs, outputs]: [usize; 2], stride: usize, device: &Device) -> Self {
        let norm = || BatchNorm::new(outputs, device);
        Self {
            conv1: conv([inputs, outputs], 3, stride, device),
            bn1: norm(),
            conv2: conv([outputs, outputs], 3, 1, device),
            bn2: norm(),
            downsample: (stride > 1).then(|| (conv([inputs, outputs], 1, stride, device), norm())),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = self.bn1.after(&self.conv1, x.clone(), Relu);
        let y = self.bn2.after(&self.conv2, y, Relu);
        let shortcut = match &self.downsample {
            Some((conv, norm)) => norm.after(conv, x, Identity),
            None => x,
        };
        activated_sum(shortcut, y, Relu)
    }
}
