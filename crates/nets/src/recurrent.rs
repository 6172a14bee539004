//! The loop of RAFT (Teed and Deng 2020) and the networks derived from it: look up correlations where the flow points,
//! update a hidden state, and add the change of the flow that it gives.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Int, Tensor};
use srflow_ops::correlation::tensor::Correlation;

use crate::MemoryNeed;
use crate::blocks::{Encoder, KEPT_BYTES};
use crate::estimate::{Encoded, Estimate, Memory, Request};
use crate::facts::{Facts, Start};
use crate::features::Features;
use crate::frames::{Border, Frames, prepared};
use crate::settings::Setting;
use crate::table::FlowNetwork;

/// Pixels of a frame along the side of a coarse pixel.
pub(crate) const STRIDE: usize = 8;
/// Levels of the correlation pyramid.
pub(crate) const LEVELS: usize = 4;

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

    /// From hidden state, flow and windows of correlations to what a refinement gives, for one context and what is remembered
    /// of the pairs before.
    fn step(
        &self,
        context: Tensor<4>,
        memory: Option<&Memory>,
    ) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Refined;

    /// Fine flow from the hidden state and coarse flow.
    fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4>;

    /// See [`Network::settings`](crate::Network::settings).
    fn settings(&mut self) -> Vec<Setting<'_>> {
        Vec::new()
    }
}

/// What a refinement gives.
pub(crate) struct Refined {
    /// The next hidden state.
    pub(crate) hidden: Tensor<4>,
    /// What is added to the flow.
    pub(crate) change: Tensor<4>,
    /// What the next pair remembers if this refinement is the last.
    pub(crate) memory: Option<Memory>,
}

/// Of every network that refines as RAFT does; the coarsest level of a correlation pyramid is two pixels wide at the smallest
/// side.
pub(crate) const FACTS: Facts = Facts {
    padding: STRIDE,
    smallest_side: 128,
    start: Start::Coarse(STRIDE),
    recompute: true,
    trains: true,
    ..Facts::DEFAULT
};

/// Memory of GMA and SKFlow, which keep the weights of their attention.
pub(crate) const ATTENDING: MemoryNeed =
    MemoryNeed { fixed: 370_000_000, per_pixel: 275, attending: 1, most_weights: KEPT_BYTES as u64 };

/// Features of the frames of both sides of as many pairs, already prepared.
fn features_of_both(encoder: &Encoder, frames: [Tensor<4>; 2]) -> [Tensor<4>; 2] {
    // One after the other: both at once would double the memory, which is at its highest here.
    frames.map(|frames| encoder.forward(frames))
}

impl<N: Recurrent> FlowNetwork for N {
    fn features(&self, frames: Tensor<4>) -> Features {
        let [batch, _, height, width] = frames.dims();
        let frames = prepared(frames, Border::new([height, width], STRIDE));
        Features::new(batch, vec![self.encoders().features.forward(frames)])
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        Recurrent::settings(self)
    }

    fn encode(&self, frames: Frames) -> Option<Encoded> {
        let encoders = self.encoders();
        let (first, second, _) = frames.prepared(STRIDE);
        let [of_first, of_second] = features_of_both(encoders.features, [first.clone(), second]);
        let [hidden, context] = encoders.hidden_and_context(first);
        Some(Encoded { hidden, constant: vec![context, of_first, of_second] })
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        assert!(request.iterations > 0, "at least one iteration");
        let encoders = self.encoders();
        let (first, second, border) = frames.prepared(STRIDE);
        let (mut hidden, context, [first, second]) = match &request.encoded {
            Some(Encoded { hidden, constant }) => {
                let [context, first, second] = constant.as_slice() else {
                    panic!("the output of this network's encoders")
                };
                (hidden.clone(), context.clone(), [first.clone(), second.clone()])
            }
            None => {
                let [hidden, context] = encoders.hidden_and_context(first.clone());
                let features = match &request.features {
                    Some(known) => known.clone().map(|features| features.into_maps::<1>()).map(|[map]| map),
                    None => features_of_both(encoders.features, [first, second]),
                };
                (hidden, context, features)
            }
        };
        let correlation = Correlation::new(first, second, LEVELS);
        let step = self.step(context, request.memory.as_ref());

        let [batch, _, height, width] = hidden.dims();
        let grid = pixel_grid([batch, height, width], &hidden.device());
        let mut flow = grid.zeros_like();
        if let Some(start) = &request.start {
            assert_eq!(start.dims(), flow.dims(), "the coarse flow to start from");
            flow = start.clone();
        }
        let (mut flows, mut memory) = (Vec::new(), None);
        for iteration in 1..=request.iterations {
            flow = flow.detach();
            let windows = correlation.windows(grid.clone() + flow.clone(), encoders.radius);
            let refined = step(hidden, flow.clone(), windows);
            (hidden, memory) = (refined.hidden, refined.memory);
            flow = flow + refined.change;
            if request.every_iteration || iteration == request.iterations {
                flows.push(border.remove(self.upsample(&hidden, flow.clone())));
            }
        }
        Estimate { coarse: Some(flow), hidden: Some(hidden), memory, ..Estimate::of_flows(flows) }
    }
}

/// Every pixel's x and y: `[batch, 2, height, width]`.
pub(crate) fn pixel_grid([batch, height, width]: [usize; 3], device: &Device) -> Tensor<4> {
    let axis = |len: usize| Tensor::<1, Int>::arange(0..len as i64, device).float();
    let x = axis(width).reshape([1, 1, 1, width]).expand([batch, 1, height, width]);
    let y = axis(height).reshape([1, 1, height, 1]).expand([batch, 1, height, width]);
    Tensor::cat(vec![x, y], 1)
}
