//! RAFT (Teed and Deng, ECCV 2020): <https://arxiv.org/abs/2003.12039>. Parity with the reference: `PARITY.md`.

use burn::config::Config;
use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use srflow_ops::correlation::tensor::Correlation;

use crate::blocks::{
    ConvexMask, Encoder, EncoderConfig, FlowHead, MotionEncoder, NormKind, SepConvGru, convex_mask,
    convex_upsample, window_entries,
};
use crate::features::Features;
use crate::frames::Frames;
use crate::recurrent::{Estimate, Loop, Request, STRIDE};

/// Channels of the hidden state, and of the context.
pub(crate) const HIDDEN: usize = 128;

/// The network of the paper.
#[derive(Config, Debug)]
pub struct RaftConfig {
    /// Levels of the correlation pyramid.
    #[config(default = "4")]
    pub levels: usize,
    /// Radius of the window that is looked up in each.
    #[config(default = "4")]
    pub radius: usize,
}

/// See [`RaftConfig`].
#[derive(Module, Debug)]
pub struct Raft {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
    levels: usize,
    radius: usize,
}

#[derive(Module, Debug)]
struct UpdateBlock {
    encoder: MotionEncoder,
    gru: SepConvGru,
    flow_head: FlowHead,
    mask: ConvexMask,
}

impl RaftConfig {
    /// With random parameters, as training starts.
    pub fn init(&self, device: &Device) -> Raft {
        Raft {
            fnet: EncoderConfig::basic(256, NormKind::Instance).init(device),
            cnet: EncoderConfig::basic(2 * HIDDEN, NormKind::Batch).init(device),
            update_block: UpdateBlock {
                encoder: MotionEncoder::new(window_entries(self.levels, self.radius), device),
                gru: SepConvGru::new(HIDDEN, 128 + HIDDEN, device),
                flow_head: FlowHead::new(HIDDEN, 256, device),
                mask: convex_mask(HIDDEN, device),
            },
            levels: self.levels,
            radius: self.radius,
        }
    }
}

impl Raft {
    /// Features of frames, RGB in 0..1, `[batch, 3, height, width]`, for [`Request::features`].
    pub fn features(&self, frames: Tensor<4>) -> Features {
        Features::of(&self.fnet, frames)
    }

    /// Flow from the first frames to the second. Panics when the frames differ in size.
    pub fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let (first, second, border) = frames.prepared(STRIDE);
        let (hidden, context) = hidden_and_context(&self.cnet, first.clone(), HIDDEN);
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
            upsample: |hidden: &Tensor<4>, flow| convex_upsample(&block.mask, hidden, flow),
        };
        refinement.run(hidden, request)
    }
}

/// Features of both frames, ready to be looked up.
pub(crate) fn correlate(
    encoder: &Encoder,
    frames: [Tensor<4>; 2],
    levels: usize,
    request: &Request,
) -> Correlation {
    let [first, second] = request.features.clone().unwrap_or_else(|| Features::of_both(encoder, frames));
    Correlation::new(first.0, second.0, levels)
}

/// The first hidden state, and what stays the same in every iteration.
pub(crate) fn hidden_and_context(
    encoder: &Encoder,
    first: Tensor<4>,
    hidden: usize,
) -> (Tensor<4>, Tensor<4>) {
    let both = encoder.forward(first);
    let context = both.dims()[1] - hidden;
    (both.clone().narrow(1, 0, hidden).tanh(), relu(both.narrow(1, hidden, context)))
}
