//! A level of a pyramid of feature maps from which RPKNet and DPFlow refine flow.

use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use srflow_ops::concatenate;
use srflow_ops::correlation::tensor::Correlation;

/// What refinements at a level read of a pair of frames, from the feature map of each: two thirds of the channels are correlated,
/// half of the others are the context, and the rest is the hidden state.
pub(crate) struct Level {
    pub(crate) correlation: Correlation,
    pub(crate) context: Tensor<4>,
    /// Initial hidden state.
    pub(crate) hidden: Tensor<4>,
}

impl Level {
    pub(crate) fn new(first: Tensor<4>, second: Tensor<4>) -> Self {
        let channels = first.dims()[1];
        let matched = channels / 3 * 2;
        let half = (channels - matched) / 2;
        let both = |from: usize| {
            let [first, second] = [&first, &second].map(|map| map.clone().narrow(1, matched + from, half));
            concatenate(vec![first, second])
        };
        let (context, hidden) = (relu(both(0)), both(half).tanh());
        let [first, second] = [first, second].map(|map| map.narrow(1, 0, matched));
        Self { correlation: Correlation::new(first, second, 1), context, hidden }
    }
}
