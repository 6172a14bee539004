//! RAFT (Teed and Deng, ECCV 2020): <https://arxiv.org/abs/2003.12039>. Parity with the reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_ops::concatenate;

use crate::blocks::{
    Aggregate, Attention, ConvexMask, Encoder, EncoderConfig, FlowHead, Gru, MotionEncoder, NormKind,
    SepConvGru, bilinear_upsample, convex_mask_by, convex_upsample, window_entries,
};
use crate::estimate::Memory;
use crate::facts::{Facts, IterationPresets, ptlflow};
use crate::memory_need::MemoryNeed;
use crate::network::Entry;
use crate::recurrent::{self, Encoders, Recurrent, Refined, STRIDE};

/// Channels of the hidden state, and of the context.
pub(crate) const HIDDEN: usize = 128;
/// Radius of the lookup window in each level.
pub(crate) const RADIUS: usize = 4;

pub(crate) const RAFT: Entry<Raft> = Entry {
    facts: Facts {
        name: "raft",
        title: "RAFT",
        paper: "https://arxiv.org/abs/2003.12039",
        parameters: 5_257_536,
        iterations: IterationPresets { default: 32, authors: 32, training: 12 },
        memory: MemoryNeed { fixed: 235_000_000, per_pixel: 340, attending: 0, most_weights: 0 },
        authors: "https://github.com/princeton-vl/RAFT",
        licence: "BSD-3-Clause",
        published: &[
            ptlflow!("raft", "chairs", "590f38f7"),
            ptlflow!("raft", "things", "802bbcfd"),
            ptlflow!("raft", "sintel", "fb44381e"),
            ptlflow!("raft", "kitti", "3a831a4b"),
        ],
        ..recurrent::FACTS
    },
    init: Raft::new,
};

/// RAFT, its small variant or GMA.
#[derive(Module, Debug)]
pub struct Raft {
    pub(crate) fnet: Encoder,
    pub(crate) cnet: Encoder,
    pub(crate) update_block: UpdateBlock,
    /// Only in GMA.
    pub(crate) att: Option<Attention>,
    /// Channels of the hidden state.
    pub(crate) hidden: usize,
    /// Radius of the lookup window in each level.
    pub(crate) radius: usize,
}

/// `BasicUpdateBlock`, `SmallUpdateBlock` or `GMAUpdateBlock`.
#[derive(Module, Debug)]
pub(crate) struct UpdateBlock {
    pub(crate) encoder: MotionEncoder,
    pub(crate) gru: Gru,
    pub(crate) flow_head: FlowHead,
    /// Not in the small variant.
    pub(crate) mask: Option<ConvexMask>,
    /// Only in GMA.
    pub(crate) aggregator: Option<Aggregate>,
}

impl Raft {
    pub(crate) fn new(device: &Device) -> Self {
        Self {
            fnet: EncoderConfig::basic(256, NormKind::Instance).init(device),
            cnet: EncoderConfig::basic(2 * HIDDEN, NormKind::Batch).init(device),
            update_block: UpdateBlock::new(window_entries(RADIUS), STRIDE, device),
            att: None,
            hidden: HIDDEN,
            radius: RADIUS,
        }
    }
}

impl UpdateBlock {
    /// RAFT's for this many correlations per pixel, and upsampling by `factor`.
    pub(crate) fn new(entries: usize, factor: usize, device: &Device) -> Self {
        Self {
            encoder: MotionEncoder::of_entries(entries, device),
            gru: Gru::Separable(SepConvGru::new(HIDDEN, 128 + HIDDEN, device)),
            flow_head: FlowHead::new(HIDDEN, 256, device),
            mask: Some(convex_mask_by(factor, HIDDEN, device)),
            aggregator: None,
        }
    }
}

impl Recurrent for Raft {
    fn encoders(&self) -> Encoders<'_> {
        Encoders { features: &self.fnet, context: &self.cnet, hidden: self.hidden, radius: self.radius }
    }

    fn step(
        &self,
        context: Tensor<4>,
        _: Option<&Memory>,
    ) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Refined<Option<Memory>> {
        let block = &self.update_block;
        let gru = block.gru.prepared(&context);
        let attending = self.att.as_ref().zip(block.aggregator.as_ref());
        let attending = attending.map(|(attention, aggregator)| (attention.forward(context), aggregator));
        move |hidden, flow, windows| {
            let mut motion = block.encoder.forward(flow, windows);
            if let Some((map, aggregator)) = &attending {
                let global = aggregator.forward(map, motion.clone());
                motion = concatenate(vec![motion, global]);
            }
            let hidden = gru.step(hidden, motion);
            Refined { change: block.flow_head.forward(hidden.clone()), hidden, further: None }
        }
    }

    fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        match &self.update_block.mask {
            Some(mask) => convex_upsample(mask, hidden, flow),
            None => bilinear_upsample(flow, STRIDE),
        }
    }
}
