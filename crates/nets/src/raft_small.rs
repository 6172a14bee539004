//! RAFT-S, the small variant of RAFT (Teed and Deng, ECCV 2020): <https://arxiv.org/abs/2003.12039>. Parity with the
//! reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::blocks::{
    ConvGru, Encoder, EncoderConfig, FlowHead, NormKind, SmallMotionEncoder, bilinear_upsample,
};
use crate::estimate::Memory;
use crate::facts::{Facts, ptlflow};
use crate::memory_need::MemoryNeed;
use crate::network::Entry;
use crate::raft::{RAFT, authors_name};
use crate::recurrent::{Encoders, Recurrent, Refined, STRIDE};

/// Channels of the hidden state.
pub(crate) const HIDDEN: usize = 96;
/// Channels of the context.
const CONTEXT: usize = 64;
/// Radius of the lookup window in each level.
pub(crate) const RADIUS: usize = 3;

pub(crate) const RAFT_SMALL: Entry<RaftSmall> = Entry {
    facts: Facts {
        name: "raft-small",
        title: "RAFT-S",
        parameters: 990_162,
        memory: MemoryNeed { fixed: 125_000_000, per_pixel: 235, attending: 0, most_weights: 0 },
        published: &[ptlflow!("raft_small", "things", "b7d9f997")],
        renamed: |name| Some(authors_name(name, false)),
        ..RAFT.facts
    },
    init: RaftSmall::new,
};

#[derive(Module, Debug)]
pub struct RaftSmall {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
}

#[derive(Module, Debug)]
struct UpdateBlock {
    encoder: SmallMotionEncoder,
    gru: ConvGru,
    flow_head: FlowHead,
}

impl RaftSmall {
    pub(crate) fn new(device: &Device) -> Self {
        Self {
            fnet: EncoderConfig::small(128, NormKind::Instance).init(device),
            cnet: EncoderConfig::small(HIDDEN + CONTEXT, NormKind::None).init(device),
            update_block: UpdateBlock {
                encoder: SmallMotionEncoder::new(RADIUS, device),
                gru: ConvGru::new(HIDDEN, 82 + CONTEXT, device),
                flow_head: FlowHead::new(HIDDEN, 128, device),
            },
        }
    }
}

impl Recurrent for RaftSmall {
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
        move |hidden, flow, windows| {
            let hidden = gru.step(hidden, block.encoder.forward(flow, windows));
            Refined { change: block.flow_head.forward(hidden.clone()), hidden, memory: None }
        }
    }

    fn upsample(&self, _: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        bilinear_upsample(flow, STRIDE)
    }
}
