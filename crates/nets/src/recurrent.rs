//! The loop of RAFT (Teed and Deng 2020) and the networks derived from it: look up correlations where the flow points,
//! update a hidden state, and add the change of the flow that it gives.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Int, Tensor};
use srflow_ops::correlation::tensor::Correlation;

use crate::blocks::Encoder;
use crate::encoded::Encoded;
use crate::features::Features;
use crate::frames::Frames;

/// Pixels of a frame along the side of a coarse pixel.
pub(crate) const STRIDE: usize = 8;
/// Levels of the correlation pyramid.
pub(crate) const LEVELS: usize = 4;

/// How to estimate.
#[derive(Debug, Clone)]
pub struct Request {
    /// Refinements.
    pub iterations: usize,
    /// The coarse flow to start from, such as [`Estimate::coarse`] of the previous pair, warped forward; zero without one.
    pub start: Option<Tensor<4>>,
    /// Return the flow of every iteration, as training needs; otherwise only the last is upsampled.
    pub every_iteration: bool,
    /// Features of the first and second frames, if they are known; see [`Features`].
    pub features: Option<[Features; 2]>,
    /// The output of all encoders, if it is known; only the size of the frames is used then.
    pub encoded: Option<Encoded>,
}

impl Request {
    /// Only the last flow, from zero.
    pub fn new(iterations: usize) -> Self {
        Self { iterations, start: None, every_iteration: false, features: None, encoded: None }
    }
}

/// What a network gives.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Flow in pixels, `[batch, 2, height, width]` (u, v), of the last iteration or of all.
    pub flows: Vec<Tensor<4>>,
    /// The last flow at an eighth of the padded size, in coarse pixels: a start for the next pair of frames.
    pub coarse: Tensor<4>,
    /// The last hidden state.
    pub hidden: Tensor<4>,
}

impl Estimate {
    /// The last flow.
    pub fn last(&self) -> &Tensor<4> {
        &self.flows[self.flows.len() - 1]
    }
}

/// What all of these networks compute before the first iteration.
pub(crate) struct Encoders<'a> {
    /// For correlations.
    pub(crate) features: &'a Encoder,
    /// For the first hidden state and the context.
    pub(crate) context: &'a Encoder,
    /// Channels of the hidden state.
    pub(crate) hidden: usize,
    /// Radius of the window of correlations that is looked up in each level.
    pub(crate) radius: usize,
}

impl Encoders<'_> {
    /// The first hidden state, and the context, which no iteration changes.
    fn hidden_and_context(&self, first: Tensor<4>) -> [Tensor<4>; 2] {
        let both = self.context.forward(first);
        let context = both.dims()[1] - self.hidden;
        [both.clone().narrow(1, 0, self.hidden).tanh(), relu(both.narrow(1, self.hidden, context))]
    }
}

/// A network that refines flow as RAFT does; it implements what differs between them.
pub(crate) trait Recurrent {
    fn encoders(&self) -> Encoders<'_>;

    /// From hidden state, flow and windows of correlations to the next hidden state and the change of the flow, for one
    /// context.
    fn step(&self, context: Tensor<4>) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> [Tensor<4>; 2];

    /// Fine flow from the hidden state and coarse flow.
    fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4>;

    /// See [`Network::features`](crate::Network::features).
    fn features(&self, frames: Tensor<4>) -> Features {
        Features::of(self.encoders().features, frames)
    }

    /// See [`Network::encode`](crate::Network::encode).
    fn encode(&self, frames: Frames) -> Encoded {
        let encoders = self.encoders();
        let (first, second, _) = frames.prepared(STRIDE);
        let features = Features::of_both(encoders.features, [first.clone(), second]);
        let [hidden, context] = encoders.hidden_and_context(first);
        Encoded { hidden, context, features: features.map(|features| features.0) }
    }

    /// See [`Network::forward`](crate::Network::forward).
    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        assert!(request.iterations > 0, "at least one iteration");
        let encoders = self.encoders();
        let (first, second, border) = frames.prepared(STRIDE);
        let ([mut hidden, context], known) = match &request.encoded {
            Some(Encoded { hidden, context, features }) => {
                ([hidden.clone(), context.clone()], Some(features.clone().map(Features)))
            }
            None => (encoders.hidden_and_context(first.clone()), request.features.clone()),
        };
        let features = known.unwrap_or_else(|| Features::of_both(encoders.features, [first, second]));
        let [first, second] = features.map(|features| features.0);
        let correlation = Correlation::new(first, second, LEVELS);
        let step = self.step(context);

        let [batch, _, height, width] = hidden.dims();
        let grid = pixel_grid([batch, height, width], &hidden.device());
        let mut flow = grid.zeros_like();
        if let Some(start) = &request.start {
            assert_eq!(start.dims(), flow.dims(), "the coarse flow to start from");
            flow = start.clone();
        }
        let mut flows = Vec::new();
        for iteration in 1..=request.iterations {
            flow = flow.detach();
            let windows = correlation.windows(grid.clone() + flow.clone(), encoders.radius);
            let [next, change] = step(hidden, flow.clone(), windows);
            hidden = next;
            flow = flow + change;
            if request.every_iteration || iteration == request.iterations {
                flows.push(border.remove(self.upsample(&hidden, flow.clone())));
            }
        }
        Estimate { flows, coarse: flow, hidden }
    }
}

/// Every pixel's x and y: `[batch, 2, height, width]`.
fn pixel_grid([batch, height, width]: [usize; 3], device: &Device) -> Tensor<4> {
    let axis = |len: usize| Tensor::<1, Int>::arange(0..len as i64, device).float();
    let x = axis(width).reshape([1, 1, 1, width]).expand([batch, 1, height, width]);
    let y = axis(height).reshape([1, 1, height, 1]).expand([batch, 1, height, width]);
    Tensor::cat(vec![x, y], 1)
}
