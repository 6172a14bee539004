//! GMA (Jiang et al., ICCV 2021): <https://arxiv.org/abs/2104.02409>. RAFT whose hidden state also sees the motion of
//! pixels of similar context. Parity with the reference: `PARITY.md`.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::blocks::{
    Aggregate, Attention, ConvexMask, Encoder, EncoderConfig, FlowHead, MotionEncoder, NormKind, SepConvGru,
    convex_mask, convex_upsample, window_entries,
};
use crate::encoded::Encoded;
use crate::features::Features;
use crate::frames::Frames;
use crate::raft::{HIDDEN, correlate, encode, hidden_and_context};
use crate::recurrent::{Estimate, Loop, Request, STRIDE};

/// The network of the paper: one head, attention to content only.
#[derive(Config, Debug)]
pub struct GmaConfig {
    /// Levels of the correlation pyramid.
    #[config(default = "4")]
    pub levels: usize,
    /// Radius of the window that is looked up in each.
    #[config(default = "4")]
    pub radius: usize,
}

/// See [`GmaConfig`].
#[derive(Module, Debug)]
pub struct Gma {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
    att: Attention,
    levels: usize,
    radius: usize,
}

#[derive(Module, Debug)]
struct UpdateBlock {
    encoder: MotionEncoder,
    gru: SepConvGru,
    flow_head: FlowHead,
    mask: ConvexMask,
    aggregator: Aggregate,
}

impl GmaConfig {
    /// With random parameters, as training starts.
    pub fn init(&self, device: &Device) -> Gma {
        Gma {
            fnet: EncoderConfig::basic(256, NormKind::Instance).init(device),
            cnet: EncoderConfig::basic(2 * HIDDEN, NormKind::Batch).init(device),
            update_block: UpdateBlock {
                encoder: MotionEncoder::new(window_entries(self.levels, self.radius), device),
                gru: SepConvGru::new(HIDDEN, 128 + 2 * HIDDEN, device),
                flow_head: FlowHead::new(HIDDEN, 256, device),
                mask: convex_mask(HIDDEN, device),
                aggregator: Aggregate::new(128, device),
            },
            att: Attention::new(HIDDEN, device),
            levels: self.levels,
            radius: self.radius,
        }
    }
}

impl Gma {
    /// Features of frames, RGB in 0..1, `[batch, 3, height, width]`, for [`Request::features`].
    pub fn features(&self, frames: Tensor<4>) -> Features {
        Features::of(&self.fnet, frames)
    }

    /// What refinements start from and read. Panics when the frames differ in size.
    pub fn encode(&self, frames: Frames) -> Encoded {
        encode(&self.cnet, &self.fnet, frames, HIDDEN)
    }

    /// Flow from the first frames to the second. Panics when the frames differ in size.
    pub fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let (first, second, border) = frames.prepared(STRIDE);
        let (hidden, context) = hidden_and_context(&self.cnet, first.clone(), HIDDEN, request);
        let correlation = correlate(&self.fnet, [first, second], self.levels, request);
        let block = &self.update_block;
        let gru = block.gru.prepared(&context);
        let attention = self.att.forward(context);
        let refinement = Loop {
            correlation: &correlation,
            radius: self.radius,
            border,
            step: |hidden, flow, windows| {
                let motion = block.encoder.forward(flow, windows);
                let global = block.aggregator.forward(&attention, motion.clone());
                let hidden = gru.step(hidden, Tensor::cat(vec![motion, global], 1));
                (hidden.clone(), block.flow_head.forward(hidden))
            },
            upsample: |hidden: &Tensor<4>, flow| convex_upsample(&block.mask, hidden, flow),
        };
        refinement.run(hidden, request)
    }
}
