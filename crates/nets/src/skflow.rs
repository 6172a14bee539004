//! SKFlow (Sun et al., NeurIPS 2022): <https://arxiv.org/abs/2205.14623>. GMA with super kernels: blocks with large depthwise
//! kernels replace the layers of the update. Parity with the reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig, NoParameters};
use srflow_ops::Activation::{self, Gelu, Identity};
use srflow_ops::concatenate;
use srflow_ops::pointwise::tensor::pointwise_layers;

use crate::blocks::{
    Aggregate, Attention, ConvexMask, Encoder, convex_mask, convex_upsample, window_entries,
};
use crate::estimate::Memory;
use crate::facts::{Facts, IterationPresets, ptlflow};
use crate::network::Entry;
use crate::raft::{HIDDEN, RADIUS, Raft};
use crate::recurrent::{self, Encoders, Recurrent, Refined};

/// Depthwise kernel sizes of the motion encoder and the flow head.
const KERNELS: [usize; 2] = [1, 15];
/// Depthwise kernel sizes of the update of the hidden state.
const UPDATE_KERNELS: [usize; 2] = [1, 7];

pub(crate) const SKFLOW: Entry<SkFlow> = Entry {
    facts: Facts {
        name: "skflow",
        title: "SKFlow",
        paper: "https://arxiv.org/abs/2205.14623",
        parameters: 6_273_149,
        iterations: IterationPresets { default: 32, authors: 15, training: 12 },
        memory: recurrent::ATTENDING,
        authors: "https://github.com/littlespray/SKFlow",
        licence: "MIT",
        lookalikes: &["MemFlow"],
        published: &[
            ptlflow!("skflow", "things", "f84e6538"),
            ptlflow!("skflow", "sintel", "98fb67cf"),
            ptlflow!("skflow", "kitti", "4e1f8b63"),
        ],
        ..recurrent::FACTS
    },
    init: SkFlow::new,
};

#[derive(Module, Debug)]
pub struct SkFlow {
    pub(crate) fnet: Encoder,
    pub(crate) cnet: Encoder,
    pub(crate) update_block: UpdateBlock,
    pub(crate) att: Attention,
}

/// `SKUpdateBlock6_Deep_nopoolres_AllDecoder`.
#[derive(Module, Debug)]
pub(crate) struct UpdateBlock {
    pub(crate) encoder: MotionEncoder,
    gru: SuperKernelBlock,
    flow_head: SuperKernelBlock,
    pub(crate) mask: ConvexMask,
    pub(crate) aggregator: Aggregate,
}

/// `SKMotionEncoder6_Deep_nopool_res`: 128 channels, the last two of them the flow.
#[derive(Module, Debug)]
pub(crate) struct MotionEncoder {
    convc1: SuperKernelBlock,
    convc2: SuperKernelBlock,
    convf1: Conv2d,
    convf2: SuperKernelBlock,
    conv: SuperKernelBlock,
}

/// `PCBlock4_Deep_nopool_res`.
#[derive(Module, Debug)]
struct SuperKernelBlock {
    conv_list: Vec<Conv2d>,
    ffn1: (Conv2d, NoParameters, Conv2d),
    pw: Conv2d,
    ffn2: (Conv2d, NoParameters, Conv2d),
}

impl SkFlow {
    pub(crate) fn new(device: &Device) -> Self {
        let block = |inputs, outputs| SuperKernelBlock::new([inputs, outputs], KERNELS, device);
        let Raft { fnet, cnet, .. } = Raft::new(device);
        Self {
            fnet,
            cnet,
            update_block: UpdateBlock {
                encoder: MotionEncoder {
                    convc1: block(window_entries(RADIUS), 256),
                    convc2: block(256, 192),
                    convf1: Conv2dConfig::new([2, 128], [1, 1]).init(device),
                    convf2: block(128, 64),
                    conv: block(64 + 192, 128 - 2),
                },
                gru: SuperKernelBlock::new([128 + 2 * HIDDEN + 128, 128], UPDATE_KERNELS, device),
                flow_head: block(128, 2),
                mask: convex_mask(HIDDEN, device),
                aggregator: Aggregate::new(128, device),
            },
            att: Attention::new(HIDDEN, device),
        }
    }
}

impl Recurrent for SkFlow {
    fn encoders(&self) -> Encoders<'_> {
        Encoders { features: &self.fnet, context: &self.cnet, hidden: HIDDEN, radius: RADIUS }
    }

    fn step(
        &self,
        context: Tensor<4>,
        _: Option<&Memory>,
    ) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Refined<Option<Memory>> {
        let block = &self.update_block;
        let attention = self.att.forward(context.clone());
        move |hidden, flow, windows| {
            let motion = block.encoder.forward(flow, windows);
            let global = block.aggregator.forward(&attention, motion.clone());
            let [hidden, change] = block.forward(hidden, context.clone(), motion, global);
            Refined { hidden, change, further: None }
        }
    }

    fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        convex_upsample(&self.update_block.mask, hidden, flow)
    }
}

impl UpdateBlock {
    /// The next hidden state and the change of the flow, from motion features and their attention output.
    pub(crate) fn forward(
        &self,
        hidden: Tensor<4>,
        context: Tensor<4>,
        motion: Tensor<4>,
        global: Tensor<4>,
    ) -> [Tensor<4>; 2] {
        let hidden = self.gru.forward(concatenate(vec![hidden, context, motion, global]));
        [hidden.clone(), self.flow_head.forward(hidden)]
    }
}

impl MotionEncoder {
    pub(crate) fn forward(&self, flow: Tensor<4>, windows: Tensor<4>) -> Tensor<4> {
        let correlation = self.convc2.forward(self.convc1.forward_activated(windows));
        let motion = self.convf2.forward(self.convf1.forward(flow.clone(), Identity));
        let out = self.conv.forward(concatenate(vec![correlation, motion]));
        concatenate(vec![out, flow])
    }
}

impl SuperKernelBlock {
    fn new([inputs, outputs]: [usize; 2], kernels: [usize; 2], device: &Device) -> Self {
        let wide = inputs + inputs / 2;
        let pointwise = |inputs, outputs| Conv2dConfig::new([inputs, outputs], [1, 1]).init(device);
        let depthwise =
            |side| Conv2dConfig::new([inputs, inputs], [side, side]).with_depthwise(true).init(device);
        Self {
            conv_list: kernels.map(depthwise).into(),
            ffn1: (pointwise(inputs, wide), NoParameters, pointwise(wide, inputs)),
            pw: pointwise(inputs, inputs),
            ffn2: (pointwise(inputs, wide), NoParameters, pointwise(wide, outputs)),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.forward_with(x, Identity)
    }

    /// `gelu(forward(x))`.
    fn forward_activated(&self, x: Tensor<4>) -> Tensor<4> {
        self.forward_with(x, Gelu)
    }

    fn forward_with(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        // Consecutive pointwise layers are fused, so that no intermediate map is stored.
        let (mut x, rest) = match self.conv_list.as_slice() {
            [first, rest @ ..] if first.is_pointwise() => {
                let layers = [
                    self.ffn1.0.layer(None, Gelu),
                    self.ffn1.2.layer(Some(0), Gelu),
                    first.layer(Some(2), Gelu),
                ];
                (pointwise_layers(x, layers), rest)
            }
            all => {
                let inner = self.ffn1.0.forward(x.clone(), Gelu);
                (self.ffn1.2.forward_add(inner, x, Gelu), all)
            }
        };
        for conv in rest {
            x = conv.forward_add(x.clone(), x, Gelu);
        }
        let layers = [
            self.pw.layer(Some(0), Gelu),
            self.ffn2.0.layer(None, Gelu),
            self.ffn2.2.layer(None, activation),
        ];
        pointwise_layers(x, layers)
    }
}
