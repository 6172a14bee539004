//! The parts of RAFT and the networks derived from it: `crate::recurrent` and `crate::blocks` as a graph.

use srflow_ops::Activation::{Identity, Relu, Sigmoid, Tanh};

use super::Pair;
use super::graph::{Graph, Length, Value};
use super::operations::Beyond;
use crate::recurrent::{LEVELS, STRIDE};

/// Factor of the scores of convex upsampling, as in `crate::blocks`.
const SCORE_SCALE: f32 = 0.25;

/// Normalization after a convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Norm {
    None,
    Instance,
    Batch,
}

/// What differs between the networks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Parts {
    /// Of the encoder `cnet`; that of `fnet` is instance norm.
    pub(super) context_norm: Norm,
    /// Channels of the hidden state.
    pub(super) hidden: i64,
    /// Of the window of correlations in each level.
    pub(super) radius: usize,
}

/// What the encoders give.
pub(super) struct Begun {
    pub(super) hidden: Value,
    pub(super) context: Value,
    correlation: Correlation,
}

/// The products of all pairs of pixels, in levels of half the size of the second frame each.
struct Correlation {
    /// Height and width of the feature maps.
    size: [Length; 2],
    /// Places of a window.
    side: i64,
    levels: Vec<Level>,
}

struct Level {
    /// `[pixels, 1, height, width]`.
    products: Value,
    /// From pixels of the feature maps to the positions of [`Graph::sampled`]: `[2]`.
    scale: Value,
    /// Those of a window around pixel 0: `[1, side, side, 2]`.
    window: Value,
}

/// The encoders of a pair.
pub(super) fn begun(graph: &mut Graph, pair: &Pair, parts: Parts) -> Begun {
    graph.begin("frame1_features");
    let first = encoded(graph, "fnet", &pair.first, Norm::Instance);
    graph.begin("frame2_features");
    let second = encoded(graph, "fnet", &pair.second, Norm::Instance);
    graph.begin("context");
    let both = encoded(graph, "cnet", &pair.first, parts.context_norm);
    let hidden = graph.channels(&both, 0, parts.hidden);
    let hidden = graph.activated(hidden, Tanh);
    let context = graph.channels(&both, parts.hidden, both.known(1) - parts.hidden);
    let context = graph.activated(context, Relu);
    graph.begin("correlation");
    let correlation = Correlation::new(graph, [&first, &second], parts.radius);
    Begun { hidden, context, correlation }
}

impl Begun {
    /// Hidden state and flow after some iterations, each of which is `step`: from hidden state, flow and windows of correlations to the next
    /// hidden state and the change of the flow.
    pub(super) fn refined(
        self,
        graph: &mut Graph,
        iterations: usize,
        mut step: impl FnMut(&mut Graph, &Value, &Value, &Value) -> [Value; 2],
    ) -> [Value; 2] {
        let mut hidden = self.hidden;
        let mut flow = graph.zeros(hidden.with_channels(2));
        for iteration in 1..=iterations {
            graph.begin(format!("iteration_{iteration}"));
            let windows = self.correlation.windows(graph, &flow);
            let change;
            [hidden, change] = step(graph, &hidden, &flow, &windows);
            flow = graph.add(&flow, &change);
        }
        graph.begin("upsampling");
        [hidden, flow]
    }
}

/// `Encoder` of `crate::blocks`, with one output scale.
fn encoded(graph: &mut Graph, name: &str, frames: &Value, norm: Norm) -> Value {
    let normed = |graph: &mut Graph, conv: &str, norm_name: &str, x: &Value, stride, activation| {
        let y = graph.conv(conv, x, stride, Identity);
        let y = match norm {
            Norm::None => y,
            Norm::Instance => graph.instance_norm(&y),
            Norm::Batch => graph.batch_norm(norm_name, &y),
        };
        graph.activated(y, activation)
    };
    let mut x = normed(graph, &format!("{name}.conv1"), &format!("{name}.norm1"), frames, 2, Relu);
    for (layer, block) in [(1, 0), (1, 1), (2, 0), (2, 1), (3, 0), (3, 1)] {
        let part = |part: &str| format!("{name}.layer{layer}.{block}.{part}");
        let stride = if layer > 1 && block == 0 { 2 } else { 1 };
        // A bottleneck has three convolutions, and the second one reduces the size.
        let bottleneck = graph.has(&part("conv3.weight"));
        let strides = if bottleneck { [1, stride] } else { [stride, 1] };
        let mut y = normed(graph, &part("conv1"), &part("norm1"), &x, strides[0], Relu);
        y = normed(graph, &part("conv2"), &part("norm2"), &y, strides[1], Relu);
        if bottleneck {
            y = normed(graph, &part("conv3"), &part("norm3"), &y, 1, Relu);
        }
        if graph.has(&part("downsample.0.weight")) {
            x = normed(graph, &part("downsample.0"), &part("downsample.1"), &x, stride, Identity);
        }
        x = graph.add(&x, &y);
        x = graph.activated(x, Relu);
    }
    graph.conv(&format!("{name}.conv2"), &x, 1, Identity)
}

impl Correlation {
    fn new(graph: &mut Graph, maps: [&Value; 2], radius: usize) -> Self {
        let size = maps[0].size();
        let channels = maps[0].known(1);
        let pixels = graph.times(&size[0], &size[1]);
        let [first, second] = maps.map(|map| graph.reshape(map, vec![channels.into(), pixels.clone()]));
        let first = graph.transpose(&first, &[1, 0]);
        let first = graph.scale(&first, 1.0 / (channels as f32).sqrt());
        let products = graph.product(&first, &second);
        let [height, width] = size.clone();
        let mut products = graph.reshape(&products, vec![pixels, 1.into(), height, width]);
        // The slower index of a window goes along x, as in the reference.
        let side = 2 * radius + 1;
        let place = |at: usize| at as f32 - radius as f32;
        let places: Vec<f32> =
            (0..side * side).flat_map(|entry| [place(entry / side), place(entry % side)]).collect();
        let side = side as i64;
        let places = graph.constant(&places, &[1, side, side, 2]);
        let mut levels = Vec::with_capacity(LEVELS);
        for level in 0..LEVELS {
            if level > 0 {
                products = graph.pooled(&products, 2);
            }
            let of_level = graph.sampling_scale(products.size());
            let window = graph.multiply(&places, &of_level);
            let window = graph.shift(&window, -1.0);
            let scale = graph.scale(&of_level, 0.5_f32.powi(level as i32));
            levels.push(Level { products: products.clone(), scale, window });
        }
        Self { size, side, levels }
    }

    /// The windows around the targets of a flow: `[1, levels side^2, height, width]`.
    fn windows(&self, graph: &mut Graph, flow: &Value) -> Value {
        let [height, width] = self.size.clone();
        let pixels = graph.times(&height, &width);
        let targets = graph.targets(flow);
        let targets = graph.reshape(&targets, vec![2.into(), pixels.clone()]);
        let targets = graph.transpose(&targets, &[1, 0]);
        let targets = graph.reshape(&targets, vec![pixels.clone(), 1.into(), 1.into(), 2.into()]);
        let mut windows = Vec::with_capacity(self.levels.len());
        for level in &self.levels {
            let positions = graph.multiply(&targets, &level.scale);
            let positions = graph.add(&positions, &level.window);
            let window = graph.sampled(&level.products, &positions, Beyond::Zeros);
            windows.push(graph.reshape(&window, vec![pixels.clone(), (self.side * self.side).into()]));
        }
        let windows = graph.concat(&windows.iter().collect::<Vec<_>>(), 1);
        let entries = windows.length(1);
        let windows = graph.transpose(&windows, &[1, 0]);
        graph.reshape(&windows, vec![1.into(), entries, height, width])
    }
}

/// A step of a GRU, whose three convolutions have these names.
pub(super) fn gru_step(
    graph: &mut Graph,
    [update, reset, candidate]: [&str; 3],
    hidden: &Value,
    input: &[&Value],
) -> Value {
    let with_input = |graph: &mut Graph, hidden: &Value| {
        let parts: Vec<&Value> = [hidden].into_iter().chain(input.iter().copied()).collect();
        graph.concat(&parts, 1)
    };
    let both = with_input(graph, hidden);
    let [update, reset] = [update, reset].map(|name| graph.conv(name, &both, 1, Sigmoid));
    let kept = graph.multiply(&reset, hidden);
    let both = with_input(graph, &kept);
    let candidate = graph.conv(candidate, &both, 1, Tanh);
    let change = graph.subtract(&candidate, hidden);
    let change = graph.multiply(&update, &change);
    graph.add(hidden, &change)
}

/// `FlowHead` of `crate::blocks`: the change of the flow.
pub(super) fn flow_head(graph: &mut Graph, hidden: &Value) -> Value {
    let x = graph.conv("update_block.flow_head.conv1", hidden, 1, Relu);
    graph.conv("update_block.flow_head.conv2", &x, 1, Identity)
}

/// `convex_upsample` of `crate::blocks`.
pub(super) fn convex_upsampled(graph: &mut Graph, hidden: &Value, flow: &Value) -> Value {
    let x = graph.conv("update_block.mask.0", hidden, 1, Relu);
    let scores = graph.conv("update_block.mask.2", &x, 1, Identity);
    let scores = graph.scale(&scores, SCORE_SCALE);
    graph.convex_upsampled(flow, &scores, STRIDE as i64)
}
