//! RAFT-S, the small variant of RAFT (Teed and Deng, ECCV 2020): <https://arxiv.org/abs/2003.12039>. Parity with the
//! reference: `PARITY.md`.

use burn::tensor::Device;

use crate::blocks::{ConvGru, EncoderConfig, FlowHead, Gru, MotionEncoder, NormKind, window_entries};
use crate::facts::{Facts, ptlflow};
use crate::memory_need::MemoryNeed;
use crate::network::Entry;
use crate::raft::{RAFT, Raft, UpdateBlock, authors_name};

/// Channels of the hidden state.
pub(crate) const HIDDEN: usize = 96;
/// Channels of the context.
const CONTEXT: usize = 64;
/// Radius of the lookup window in each level.
pub(crate) const RADIUS: usize = 3;

pub(crate) const RAFT_SMALL: Entry<Raft> = Entry {
    facts: Facts {
        name: "raft-small",
        title: "RAFT-S",
        parameters: 990_162,
        memory: MemoryNeed { fixed: 125_000_000, per_pixel: 235, attending: 0, most_weights: 0 },
        published: &[ptlflow!("raft_small", "things", "b7d9f997")],
        renamed: |name| Some(authors_name(name, false)),
        ..RAFT.facts
    },
    init: raft_small,
};

fn raft_small(device: &Device) -> Raft {
    Raft {
        fnet: EncoderConfig::small(128, NormKind::Instance).init(device),
        cnet: EncoderConfig::small(HIDDEN + CONTEXT, NormKind::None).init(device),
        update_block: UpdateBlock {
            encoder: MotionEncoder::small(window_entries(RADIUS), device),
            gru: Gru::Square(ConvGru::new(HIDDEN, 82 + CONTEXT, device)),
            flow_head: FlowHead::new(HIDDEN, 128, device),
            mask: None,
            aggregator: None,
        },
        att: None,
        hidden: HIDDEN,
        radius: RADIUS,
    }
}
