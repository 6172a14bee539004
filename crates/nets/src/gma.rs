//! GMA (Jiang et al., ICCV 2021): <https://arxiv.org/abs/2104.02409>. RAFT with attention that propagates motion between pixels
//! with similar context. Parity with the reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_ops::concatenate;

use crate::blocks::{
    Aggregate, Attention, ConvexMask, Encoder, EncoderConfig, FlowHead, MotionEncoder, NormKind, SepConvGru,
    convex_mask, convex_upsample,
};
use crate::estimate::Memory;
use crate::facts::{Facts, IterationPresets, ptlflow};
use crate::network::Entry;
use crate::raft::{HIDDEN, RADIUS};
use crate::recurrent::{self, Encoders, Recurrent, Refined};

pub(crate) const GMA: Entry<Gma> = Entry {
    facts: Facts {
        name: "gma",
        title: "GMA",
        paper: "https://arxiv.org/abs/2104.02409",
        parameters: 5_879_873,
        iterations: IterationPresets { default: 32, authors: 32, training: 12 },
        memory: recurrent::ATTENDING,
        authors: "https://github.com/zacjiang/GMA",
        licence: "WTFPL",
        published: &[
            ptlflow!("gma", "chairs", "d4ec321d"),
            ptlflow!("gma", "things", "90aafb63"),
            ptlflow!("gma", "sintel", "98d6f3d0"),
            ptlflow!("gma", "kitti", "8ca3ec80"),
        ],
        ..recurrent::FACTS
    },
    init: Gma::new,
};

/// The published variant: one head, content-only attention.
#[derive(Module, Debug)]
pub struct Gma {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
    att: Attention,
}

#[derive(Module, Debug)]
struct UpdateBlock {
    encoder: MotionEncoder,
    gru: SepConvGru,
    flow_head: FlowHead,
    mask: ConvexMask,
    aggregator: Aggregate,
}

impl Gma {
    pub(crate) fn new(device: &Device) -> Self {
        Self {
            fnet: EncoderConfig::basic(256, NormKind::Instance).init(device),
            cnet: EncoderConfig::basic(2 * HIDDEN, NormKind::Batch).init(device),
            update_block: UpdateBlock {
                encoder: MotionEncoder::new(RADIUS, device),
                gru: SepConvGru::new(HIDDEN, 128 + 2 * HIDDEN, device),
                flow_head: FlowHead::new(HIDDEN, 256, device),
                mask: convex_mask(HIDDEN, device),
                aggregator: Aggregate::new(128, device),
            },
            att: Attention::new(HIDDEN, device),
        }
    }
}

impl Recurrent for Gma {
    fn encoders(&self) -> Encoders<'_> {
        Encoders { features: &self.fnet, context: &self.cnet, hidden: HIDDEN, radius: RADIUS }
    }

    fn step(
        &self,
        context: Tensor<4>,
        _: Option<&Memory>,
    ) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Refined {
        let block = &self.update_block;
        let gru = block.gru.prepared(&context);
        let attention = self.att.forward(context);
        move |hidden, flow, windows| {
            let motion = block.encoder.forward(flow, windows);
            let global = block.aggregator.forward(&attention, motion.clone());
            let hidden = gru.step(hidden, concatenate(vec![motion, global]));
            Refined { change: block.flow_head.forward(hidden.clone()), hidden, memory: None }
        }
    }

    fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        convex_upsample(&self.update_block.mask, hidden, flow)
    }
}
