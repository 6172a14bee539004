use super::entry::{Distance, SequenceLoss};

pub(super) const L2: SequenceLoss = SequenceLoss {
    name: "l2",
    description: "end-point distance",
    // The gradient of the square root is infinite at zero, so distances are clamped to at least 1e-6 pixels.
    distance: Distance::OfFlow(|difference| difference.square().sum_dim(1).clamp_min(1e-12).sqrt()),
    channels: 1,
};
