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
use crate::encoded::Encoded;
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
    let encoded = request.encoded.clone().map(|encoded| encoded.features.map(Features));
    let known = encoded.or_else(|| request.features.clone());
    let [first, second] = known.unwrap_or_else(|| Features::of_both(encoder, frames));
    Correlation::new(first.0, second.0, levels)
}

/// What refinements start from and read, with `hidden` channels of the hidden state.
pub(crate) fn encode(context: &Encoder, features: &Encoder, frames: Frames, hidden: usize) -> Encoded {
    let (first, second, _) = frames.prepared(STRIDE);
    let features = Features::of_both(features, [first.clone(), second]).map(|features| features.0);
    let (hidden, context) = hidden_and_context(context, first, hidden, &Request::new(1));
    Encoded { hidden, context, features }
}

/// The first hidden state, and what stays the same in every iteration.
pub(crate) fn hidden_and_context(
    encoder: &Encoder,
    first: Tensor<4>,
    hidden: usize,
    request: &Request,
) -> (Tensor<4>, Tensor<4>) {
    if let Some(encoded) = &request.encoded {
        return (encoded.hidden.clone(), encoded.context.clone());
    }
    let both = encoder.forward(first);
    let context = both.dims()[1] - hidden;
    (both.clone().narrow(1, 0, hidden).tanh(), relu(both.narrow(1, hidden, context)))
}
