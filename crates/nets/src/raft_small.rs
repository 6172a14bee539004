//! RAFT-S, the small network of RAFT (Teed and Deng, ECCV 2020): <https://arxiv.org/abs/2003.12039>. Parity with the
//! reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use crate::blocks::{
    ConvGru, Encoder, EncoderConfig, FlowHead, NormKind, SmallMotionEncoder, bilinear_upsample,
};
use crate::recurrent::{Encoders, Recurrent};

/// Channels of the hidden state.
const HIDDEN: usize = 96;
/// Channels of the context.
const CONTEXT: usize = 64;
/// Radius of the window of correlations that is looked up in each level.
const RADIUS: usize = 3;

/// The network of the paper.
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
    /// With random parameters, as training starts.
    pub fn new(device: &Device) -> Self {
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

    fn step(&self, context: Tensor<4>) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> [Tensor<4>; 2] {
        let block = &self.update_block;
        let gru = block.gru.prepared(&context);
        move |hidden, flow, windows| {
            let hidden = gru.step(hidden, block.encoder.forward(flow, windows));
            [hidden.clone(), block.flow_head.forward(hidden)]
        }
    }

    fn upsample(&self, _: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        bilinear_upsample(flow)
    }
}
