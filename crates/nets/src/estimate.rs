//! Inputs and outputs of networks.

use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor};

use crate::features::Features;

/// Options of [`Network::forward`](crate::Network::forward).
#[derive(Debug, Clone)]
pub struct Request {
    /// Refinement iterations; ignored by networks without refinement.
    pub iterations: usize,
    /// Stop refining earlier, after two iterations in a row in each of which coarse pixels moved by less than this many pixels of the
    /// frame on average, and at most 1 in 100 by four times as many or more, in every pair of the batch. The result is that of a request for as many [`iterations`](Self::iterations);
    /// a network with levels stops at each by itself. Ignored with [`every_iteration`](Self::every_iteration), and by the network
    /// `srflow`, whose two iterations by default leave none to save.
    pub still_px: Option<f32>,
    /// Coarse flow to start from, such as the [`Estimate::coarse`] of the previous pair, warped forward; zero by default. For
    /// networks with [`Start::Coarse`](crate::Start::Coarse) or [`Start::CoarsestLevel`](crate::Start::CoarsestLevel).
    pub start: Option<Tensor<4>>,
    /// Return the flows of all iterations, as training needs, not only the last one.
    pub every_iteration: bool,
    /// Features of the first and second frames, if already computed; see [`Features`].
    pub features: Option<[Features; 2]>,
    /// Output of all encoders, if already computed; then only the size of the frames is used.
    pub encoded: Option<Encoded>,
    /// [`Estimate::memory`] of the previous pair of the video; `None` for its first pair.
    pub memory: Option<Memory>,
}

impl Request {
    /// A request for the last flow only, starting from zero.
    pub fn new(iterations: usize) -> Self {
        Self {
            iterations,
            still_px: None,
            start: None,
            every_iteration: false,
            features: None,
            encoded: None,
            memory: None,
        }
    }

    /// The flow to start from, `[batch, 2, height, width]` in coarse pixels, where `size` is height and width. Panics when it
    /// has another size.
    pub(crate) fn start_flow(&self, batch: usize, size: [usize; 2], device: &Device) -> Tensor<4> {
        let shape = [batch, 2, size[0], size[1]];
        let Some(start) = &self.start else { return Tensor::zeros(shape, device) };
        assert_eq!(start.dims(), shape, "the coarse flow to start from");
        start.clone()
    }

    /// The features of the first and second frames: those of the request, read by `known`, or those that `encode` computes.
    pub(crate) fn features_of<T>(
        &self,
        frames: [Tensor<4>; 2],
        known: impl Fn(Features) -> T,
        encode: impl Fn(Tensor<4>) -> T,
    ) -> [T; 2] {
        match &self.features {
            Some(features) => features.clone().map(known),
            // One after the other, since peak memory is often reached here and encoding both at once would double it.
            None => frames.map(encode),
        }
    }
}

/// Output of a network.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Flow in pixels, `[batch, 2, height, width]` (u, v): the last one, or those of all iterations in order.
    pub flows: Vec<Tensor<4>>,
    /// Error distribution of each of the flows, for networks with [`Facts::mixture`](crate::Facts::mixture).
    pub mixtures: Vec<LaplaceMixture>,
    /// Probability that a pixel of the first frame is occluded in the second, `[batch, 1, height, width]`, for networks with
    /// [`Facts::occlusion`](crate::Facts::occlusion).
    pub occlusion: Option<Tensor<4>>,
    /// The last flow at coarse resolution and in coarse pixels, to start the next pair from; for networks with
    /// [`Start::Coarse`](crate::Start::Coarse) or [`Start::CoarsestLevel`](crate::Start::CoarsestLevel).
    pub coarse: Option<Tensor<4>>,
    /// The last hidden state, for networks with [`Facts::recompute`](crate::Facts::recompute).
    pub hidden: Option<Tensor<4>>,
    /// State for the next pair of the video; for networks with [`Facts::remembers`](crate::Facts::remembers).
    pub memory: Option<Memory>,
    /// Refinement iterations that were done, as [`Request::iterations`] counts them: those of the finest level, where each level has its
    /// own, and the sum over levels, where they share them. `None` for a network without refinement.
    pub iterations: Option<usize>,
}

impl Estimate {
    /// An estimate with flows only.
    pub(crate) fn of_flows(flows: Vec<Tensor<4>>) -> Self {
        Self {
            flows,
            mixtures: Vec::new(),
            occlusion: None,
            coarse: None,
            hidden: None,
            memory: None,
            iterations: None,
        }
    }

    /// The last flow.
    pub fn last(&self) -> &Tensor<4> {
        &self.flows[self.flows.len() - 1]
    }
}

/// Distribution of the error of a flow: for each pixel a mixture of two Laplace distributions, a wide and a narrow one (Wang,
/// Lipson and Deng, *SEA-RAFT*, ECCV 2024, section 3.2).
#[derive(Debug, Clone)]
pub struct LaplaceMixture {
    /// Logarithms of the mixture weights, up to a common constant: `[batch, 2, height, width]`.
    pub log_weights: Tensor<4>,
    /// Logarithms of the scales in pixels, before clamping: `[batch, 2, height, width]`, the wide one first.
    pub log_scales: Tensor<4>,
}

impl LaplaceMixture {
    /// Range of the logarithms of the scales in SEA-RAFT's training and evaluation: the wide distribution's are clamped to 0 to the
    /// second number, the narrow one's to the first to 0.
    pub const LOG_SCALE_RANGE: [f64; 2] = [0.0, 10.0];

    /// Logarithms of the scales of the wide and the narrow distribution, `[batch, 1, height, width]` each, clamped to `0..=high` and
    /// `low..=0`.
    fn limited_log_scales(&self, [low, high]: [f64; 2]) -> [Tensor<4>; 2] {
        [(0, 0.0, high), (1, low, 0.0)]
            .map(|(k, low, high)| self.log_scales.clone().narrow(1, k, 1).clamp(low, high))
    }

    /// The expected absolute error of each component of the flow, in pixels, `[batch, 1, height, width]`: the mean of both scales,
    /// weighted by the probabilities of the two distributions. The range is that of the network,
    /// [`Facts::log_scale_range`](crate::Facts::log_scale_range).
    pub fn mean_scale(&self, log_scale_range: [f64; 2]) -> Tensor<4> {
        let [wide, narrow] = self.limited_log_scales(log_scale_range).map(Tensor::exp);
        let [wide_weight, narrow_weight] = [0, 1].map(|k| self.log_weights.clone().narrow(1, k, 1));
        let wide_share = sigmoid(wide_weight - narrow_weight);
        narrow.clone() + wide_share * (wide - narrow)
    }
}

/// Output of the encoders for a pair of frames. With [`Request::encoded`], a network skips its encoders and can resume between
/// any two iterations, as training with recomputation does.
#[derive(Debug, Clone)]
pub struct Encoded {
    /// The hidden state before the first iteration, `[batch, channels, height / 8, width / 8]`.
    pub hidden: Tensor<4>,
    /// Tensors that are the same in every iteration.
    pub constant: Vec<Tensor<4>>,
}

impl Encoded {
    /// Hidden state, context, and the feature maps of both frames. Panics for the output of another network's encoders.
    pub(crate) fn of_pair(&self) -> (Tensor<4>, Tensor<4>, [Tensor<4>; 2]) {
        let [context, first, second] = self.constant.as_slice() else {
            panic!("the output of this network's encoders")
        };
        (self.hidden.clone(), context.clone(), [first.clone(), second.clone()])
    }
}

/// State of a network from earlier pairs of a video; its tensors are private to the network.
#[derive(Debug, Clone)]
pub struct Memory(pub(crate) Vec<Tensor<4>>);
