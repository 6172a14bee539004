//! What RPKNet and DPFlow share: levels of a pyramid of feature maps from which they refine flow, the update block that does, and
//! layers of their stages.

use burn::module::Module;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::Conv2d;
use srflow_ops::Activation;
use srflow_ops::concatenate;
use srflow_ops::correlation::tensor::Correlation;

use super::gru::StageGru;
use super::motion::{FlowHead, MotionEncoder};
use super::upsampler::WideConvexMask;

/// Radius of the lookup window.
pub(crate) const RADIUS: usize = 4;
/// Channels of the motion encoder.
pub(crate) const MOTION: usize = 128;

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

/// `UpdateBlock` of DPFlow, `UpdatePartialBlock` of RPKNet: stages `S` in place of the convolutions of its GRUs.
#[derive(Module, Debug)]
pub(crate) struct UpdateBlock<S: Module> {
    encoder: MotionEncoder,
    gru_list: Vec<StageGru<S>>,
    flow_head: FlowHead,
    pub(crate) mask: WideConvexMask,
}

impl<S: Module> UpdateBlock<S> {
    /// For this many channels of the hidden state, GRUs, and outputs of the flow head, of which the first two are the flow.
    pub(crate) fn new(
        hidden: usize,
        grus: usize,
        stage: impl Fn() -> S,
        outputs: usize,
        device: &Device,
    ) -> Self {
        Self {
            encoder: MotionEncoder::of_entries((2 * RADIUS + 1) * (2 * RADIUS + 1), device),
            gru_list: (0..grus).map(|_| StageGru::new(&stage)).collect(),
            flow_head: FlowHead::of_outputs(hidden, 256, outputs, device),
            mask: WideConvexMask::new(hidden, device),
        }
    }

    /// The next hidden state, and the output of the flow head; see [`StageGru::step`] for `sum`.
    pub(crate) fn step(
        &self,
        hidden: Tensor<4>,
        context: &Tensor<4>,
        [flow, windows]: [Tensor<4>; 2],
        sum: impl Fn(&S, Tensor<4>, Activation) -> Tensor<4>,
    ) -> [Tensor<4>; 2] {
        let input = concatenate(vec![context.clone(), self.encoder.forward(flow, windows)]);
        let hidden = self.gru_list.iter().fold(hidden, |hidden, gru| gru.step(hidden, &input, &sum));
        [hidden.clone(), self.flow_head.forward(hidden)]
    }
}

/// `LayerTransition`.
#[derive(Module, Debug)]
pub(crate) struct Transition {
    pub(crate) proj: Conv2d,
}

/// `DWConv`.
#[derive(Module, Debug)]
pub(crate) struct Depthwise {
    pub(crate) dwconv: Conv2d,
}
