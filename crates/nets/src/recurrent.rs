//! The refinement loop of RAFT (Teed and Deng 2020) and the networks derived from it: look up correlations around the target of
//! the flow, update a hidden state, and add the change of the flow that is decoded from it.

use burn::tensor::activation::relu;
use burn::tensor::{Device, Int, Tensor};
use srflow_ops::concatenate;
use srflow_ops::correlation::tensor::Correlation;

use crate::blocks::{Encoder, KEPT_BYTES};
use crate::estimate::{Encoded, Estimate, Memory, Request};
use crate::facts::{Facts, Start};
use crate::features::Features;
use crate::frames::Frames;
use crate::iterations::Refinement;
use crate::memory_need::MemoryNeed;
use crate::network::FlowNetwork;
use crate::settings::Setting;

/// Side of a coarse pixel in pixels of the frame.
pub(crate) const STRIDE: usize = 8;
/// Levels of the correlation pyramid.
pub(crate) const LEVELS: usize = 4;

/// The encoders that run before the first iteration.
pub(crate) struct Encoders<'a> {
    /// Encodes both frames for correlations.
    pub(crate) features: &'a Encoder,
    /// Encodes the first frame to the initial hidden state and the context.
    pub(crate) context: &'a Encoder,
    /// Channels of the hidden state.
    pub(crate) hidden: usize,
    /// Radius of the lookup window in each level.
    pub(crate) radius: usize,
}

impl Encoders<'_> {
    /// The initial hidden state, and the context, which is constant over the iterations.
    fn hidden_and_context(&self, first: Tensor<4>) -> [Tensor<4>; 2] {
        let both = self.context.forward(first);
        let context = both.dims()[1] - self.hidden;
        [both.clone().narrow(1, 0, self.hidden).tanh(), relu(both.narrow(1, self.hidden, context))]
    }
}

/// A network that refines flow like RAFT.
pub(crate) trait Recurrent {
    fn encoders(&self) -> Encoders<'_>;

    /// The function that computes an iteration from hidden state, flow and correlation windows, for this context and the memory
    /// of earlier pairs.
    fn step(
        &self,
        context: Tensor<4>,
        memory: Option<&Memory>,
    ) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Refined<Option<Memory>>;

    /// Upsamples coarse flow, `[batch, 2, height, width]`, to 8 times the size, in fine pixels.
    fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4>;

    /// See [`Network::settings`](crate::Network::settings).
    fn settings(&mut self) -> Vec<Setting<'_>> {
        Vec::new()
    }
}

/// Output of an iteration.
pub(crate) struct Refined<T = ()> {
    /// The next hidden state.
    pub(crate) hidden: Tensor<4>,
    /// Added to the flow.
    pub(crate) change: Tensor<4>,
    /// Further output: the memory for the next pair, if this iteration is the last, or the mixture of the flow.
    pub(crate) further: T,
}

/// Refines a flow until `refinement` ends: each iteration is a `step` from hidden state, flow and the windows of correlations around
/// the target of the flow. Calls `after` with the new hidden state and flow, the further output of the step, and whether the
/// iteration was the last. Returns the last hidden state and flow.
pub(crate) fn refine<T>(
    (correlation, radius): (&Correlation, usize),
    refinement: &mut Refinement,
    [mut hidden, mut flow]: [Tensor<4>; 2],
    step: impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Refined<T>,
    mut after: impl FnMut(&Tensor<4>, &Tensor<4>, T, bool),
) -> [Tensor<4>; 2] {
    let [batch, _, height, width] = flow.dims();
    let grid = pixel_grid([batch, height, width], &flow.device());
    loop {
        flow = flow.detach();
        let windows = correlation.windows(grid.clone() + flow.clone(), radius);
        let refined = step(hidden, flow.clone(), windows);
        hidden = refined.hidden;
        let last = refinement.ends_with(&refined.change);
        flow = flow + refined.change;
        after(&hidden, &flow, refined.further, last);
        if last {
            return [hidden, flow];
        }
    }
}

/// Common facts of these networks. At the smallest side, the coarsest level of the correlation pyramid is two pixels wide.
pub(crate) const FACTS: Facts = Facts {
    padding: STRIDE,
    smallest_side: 128,
    start: Start::Coarse(STRIDE),
    recompute: true,
    trains: true,
    ..Facts::DEFAULT
};

/// Memory needs of GMA and the networks derived from it, which keep attention weights.
pub(crate) const ATTENDING: MemoryNeed =
    MemoryNeed { fixed: 370_000_000, per_pixel: 275, attending: 1, most_weights: KEPT_BYTES as u64 };

impl<N: Recurrent> FlowNetwork for N {
    fn features(&self, frames: Tensor<4>) -> Features {
        Features::of_prepared(frames, STRIDE, |frames| vec![self.encoders().features.forward(frames)])
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        Recurrent::settings(self)
    }

    fn encode(&self, frames: Frames) -> Option<Encoded> {
        let encoders = self.encoders();
        let (first, second, _) = frames.prepared(STRIDE);
        let [of_first, of_second] = [first.clone(), second].map(|frames| encoders.features.forward(frames));
        let [hidden, context] = encoders.hidden_and_context(first);
        Some(Encoded { hidden, constant: vec![context, of_first, of_second] })
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let encoders = self.encoders();
        let (first, second, border) = frames.prepared(STRIDE);
        let (hidden, context, [first, second]) = match &request.encoded {
            Some(encoded) => encoded.of_pair(),
            None => {
                let [hidden, context] = encoders.hidden_and_context(first.clone());
                let features = request.features_of([first, second], Features::into_map, |frames| {
                    encoders.features.forward(frames)
                });
                (hidden, context, features)
            }
        };
        let correlation = Correlation::new(first, second, LEVELS);
        let step = self.step(context, request.memory.as_ref());

        let [batch, _, height, width] = hidden.dims();
        let flow = request.start_flow(batch, [height, width], &hidden.device());
        let (mut flows, mut memory) = (Vec::new(), None);
        let mut refinement = request.refinement(request.iterations, border);
        let lookup = (&correlation, encoders.radius);
        let [hidden, flow] =
            refine(lookup, &mut refinement, [hidden, flow], step, |hidden, flow, remembered, last| {
                if request.every_iteration || last {
                    flows.push(border.remove(self.upsample(hidden, flow.clone())));
                    memory = remembered;
                }
            });
        let iterations = Some(refinement.done());
        Estimate { coarse: Some(flow), hidden: Some(hidden), memory, iterations, ..Estimate::of_flows(flows) }
    }
}

/// Coordinates (x, y) of every pixel: `[batch, 2, height, width]`.
pub(crate) fn pixel_grid([batch, height, width]: [usize; 3], device: &Device) -> Tensor<4> {
    let axis = |len: usize| Tensor::<1, Int>::arange(0..len as i64, device).float();
    let x = axis(width).reshape([1, 1, 1, width]).expand([batch, 1, height, width]);
    let y = axis(height).reshape([1, 1, height, 1]).expand([batch, 1, height, width]);
    concatenate(vec![x, y])
}
