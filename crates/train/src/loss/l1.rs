use super::entry::{Distance, SequenceLoss};

pub(super) const L1: SequenceLoss = SequenceLoss {
    name: "l1",
    description: "absolute difference of the components; RAFT's and SKFlow's",
    distance: Distance::OfFlow(|difference| difference.abs()),
    channels: 2,
};
