//! What is asked of a network, and what it gives.

use burn::tensor::Tensor;
use burn::tensor::activation::sigmoid;

use crate::features::Features;

/// How to estimate.
#[derive(Debug, Clone)]
pub struct Request {
    /// Refinements; a network without them takes no notice.
    pub iterations: usize,
    /// The coarse flow to start from, such as [`Estimate::coarse`] of the previous pair, warped forward; zero without one.
    /// For networks with [`Start::Coarse`](crate::Start::Coarse) or [`Start::CoarsestLevel`](crate::Start::CoarsestLevel).
    pub start: Option<Tensor<4>>,
    /// Return every flow that the network computes on its way, as training needs; otherwise only the last is made in full size.
    pub every_iteration: bool,
    /// Features of the first and second frames, if they are known; see [`Features`].
    pub features: Option<[Features; 2]>,
    /// The output of all encoders, if it is known; only the size of the frames is used then.
    pub encoded: Option<Encoded>,
    /// What [`Estimate::memory`] gave for the previous pair of the video; nothing at its start.
    pub memory: Option<Memory>,
}

impl Request {
    /// Only the last flow, from zero.
    pub fn new(iterations: usize) -> Self {
        Self { iterations, start: None, every_iteration: false, features: None, encoded: None, memory: None }
    }
}

/// What a network gives.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Flow in pixels, `[batch, 2, height, width]` (u, v): the last, or all, the last one last.
    pub flows: Vec<Tensor<4>>,
    /// How sure the network is of each of the flows, for networks with [`Facts::mixture`](crate::Facts::mixture).
    pub mixtures: Vec<LaplaceMixture>,
    /// Probability that what a pixel of the first frame shows is hidden in the second, `[batch, 1, height, width]`, for
    /// networks with [`Facts::occlusion`](crate::Facts::occlusion).
    pub occlusion: Option<Tensor<4>>,
    /// The last flow in coarse pixels, a start for the next pair of frames; for networks with
    /// [`Start::Coarse`](crate::Start::Coarse) or [`Start::CoarsestLevel`](crate::Start::CoarsestLevel).
    pub coarse: Option<Tensor<4>>,
    /// The last hidden state, where refinements can be computed one by one.
    pub hidden: Option<Tensor<4>>,
    /// For the next pair of the video; for networks with [`Facts::remembers`](crate::Facts::remembers).
    pub memory: Option<Memory>,
}

impl Estimate {
    /// Of flows and nothing else.
    pub(crate) fn of_flows(flows: Vec<Tensor<4>>) -> Self {
        Self { flows, mixtures: Vec::new(), occlusion: None, coarse: None, hidden: None, memory: None }
    }

    /// The last flow.
    pub fn last(&self) -> &Tensor<4> {
        &self.flows[self.flows.len() - 1]
    }
}

/// How sure a network is of a flow: for each pixel two Laplace distributions around it, a wide and a narrow one
/// (Wang, Lipson and Deng, *SEA-RAFT*, ECCV 2024, section 3.2).
#[derive(Debug, Clone)]
pub struct LaplaceMixture {
    /// Logarithms of the weights of the two, up to a common constant: `[batch, 2, height, width]`.
    pub log_weights: Tensor<4>,
    /// Logarithms of their scales in pixels, before they are limited: `[batch, 2, height, width]`, the wide one first.
    pub log_scales: Tensor<4>,
}

impl LaplaceMixture {
    /// The range of [`limited_log_scales`](Self::limited_log_scales) that the authors train and evaluate with.
    pub const LOG_SCALE_RANGE: [f64; 2] = [0.0, 10.0];

    /// Logarithms of the scales of the wide and the narrow distribution, `[batch, 1, height, width]` each: the wide one is limited
    /// to 0 and `high`, the narrow one to `low` and 0.
    pub fn limited_log_scales(&self, [low, high]: [f64; 2]) -> [Tensor<4>; 2] {
        [(0, 0.0, high), (1, low, 0.0)]
            .map(|(k, low, high)| self.log_scales.clone().narrow(1, k, 1).clamp(low, high))
    }

    /// The mean of both scales weighted by the probabilities of the two distributions, in pixels, `[batch, 1, height, width]`: the
    /// expected distance of each component of the flow from the truth.
    pub fn mean_scale(&self) -> Tensor<4> {
        let [wide, narrow] = self.limited_log_scales(Self::LOG_SCALE_RANGE).map(Tensor::exp);
        let [wide_weight, narrow_weight] = [0, 1].map(|k| self.log_weights.clone().narrow(1, k, 1));
        let wide_share = sigmoid(wide_weight - narrow_weight);
        narrow.clone() + wide_share * (wide - narrow)
    }
}

/// The output of the encoders for a pair of frames. With [`Request::encoded`] a network skips its encoders and refines from any
/// state between two iterations, as training with recomputation does.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// The hidden state before the first refinement, `[batch, channels, height / 8, width / 8]`.
    pub hidden: Tensor<4>,
    /// What stays the same in every refinement.
    pub constant: Vec<Tensor<4>>,
}

/// What a network keeps of the earlier pairs of a video. Its tensors are the network's business.
#[derive(Debug, Clone)]
pub struct Memory(pub(crate) Vec<Tensor<4>>);
