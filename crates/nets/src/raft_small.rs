//! RAFT-S, the small network of RAFT (Teed and Deng, ECCV 2020): <https://arxiv.org/abs/2003.12039>. Parity with the
//! reference: `PARITY.md`.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::blocks::{
    ConvGru, Encoder, EncoderConfig, FlowHead, NormKind, SmallMotionEncoder, bilinear_upsample,
    window_entries,
};
use crate::encoded::Encoded;
use crate::features::Features;
use crate::frames::Frames;
use crate::raft::{correlate, encode, hidden_and_context};
use crate::recurrent::{Estimate, Loop, Request, STRIDE};

/// Channels of the hidden state.
const HIDDEN: usize = 96;
/// Channels of the context.
const CONTEXT: usize = 64;

/// The network of the paper.
#[derive(Config, Debug)]
pub struct RaftSmallConfig {
    /// Levels of the correlation pyramid.
    #[config(default = "4")]
    pub levels: usize,
    /// Radius of the window that is looked up in each.
    #[config(default = "3")]
    pub radius: usize,
}

/// See [`RaftSmallConfig`].
#[derive(Module, Debug)]
pub struct RaftSmall {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
    levels: usize,
    radius: usize,
}

#[derive(Module, Debug)]
struct UpdateBlock {
    encoder: SmallMotionEncoder,
    gru: ConvGru,
    flow_head: FlowHead,
}

impl RaftSmallConfig {
    /// With random parameters, as training starts.
    pub fn init(&self, device: &Device) -> RaftSmall {
        RaftSmall {
            fnet: EncoderConfig::small(128, NormKind::Instance).init(device),
            cnet: EncoderConfig::small(HIDDEN + CONTEXT, NormKind::None).init(device),
            update_block: UpdateBlock {
                encoder: SmallMotionEncoder::new(window_entries(self.levels, self.radius), device),
                gru: ConvGru::new(HIDDEN, 82 + CONTEXT, device),
                flow_head: FlowHead::new(HIDDEN, 128, device),
            },
            levels: self.levels,
            radius: self.radius,
        }
    }
}

impl RaftSmall {
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
        let refinement = Loop {
            correlation: &correlation,
            radius: self.radius,
            border,
            step: |hidden, flow, windows| {
                let hidden = gru.step(hidden, block.encoder.forward(flow, windows));
                (hidden.clone(), block.flow_head.forward(hidden))
            },
            upsample: |_: &Tensor<4>, flow| bilinear_upsample(flow),
        };
        refinement.run(hidden, request)
    }
}
