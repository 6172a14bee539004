//! GMA (Jiang et al., ICCV 2021): <https://arxiv.org/abs/2104.02409>. RAFT with attention that propagates motion between pixels
//! with similar context. Parity with the reference: `PARITY.md`.

use burn::tensor::Device;

use crate::blocks::{Aggregate, Attention, Gru, SepConvGru};
use crate::facts::{Facts, IterationPresets, ptlflow};
use crate::network::Entry;
use crate::raft::{HIDDEN, Raft, UpdateBlock};
use crate::recurrent;

pub(crate) const GMA: Entry<Raft> = Entry {
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
    init: gma,
};

/// The published variant: one head, content-only attention.
fn gma(device: &Device) -> Raft {
    let raft = Raft::new(device);
    let update_block = UpdateBlock {
        gru: Gru::Separable(SepConvGru::new(HIDDEN, 128 + 2 * HIDDEN, device)),
        aggregator: Some(Aggregate::new(128, device)),
        ..raft.update_block
    };
    Raft { update_block, att: Some(Attention::new(HIDDEN, device)), ..raft }
}
