//! SKFlow as a graph: `crate::skflow`.

use srflow_ops::Activation::{self, Gelu, Identity};

use super::Pair;
use super::graph::{Graph, Value};
use super::recurrent::{Norm, Parts, begun, convex_upsampled};
use crate::raft::{HIDDEN, RADIUS};

pub(crate) fn skflow(graph: &mut Graph, pair: &Pair, iterations: usize) {
    let parts = Parts { context_norm: Norm::Batch, hidden: HIDDEN as i64, radius: RADIUS };
    let begun = begun(graph, pair, parts);
    graph.begin("attention");
    let context = begun.context.clone();
    let weights = attention(graph, &context);
    let [hidden, flow] = begun.refined(graph, iterations, |graph, hidden, flow, windows| {
        let motion = motion(graph, flow, windows);
        let global = gathered(graph, &weights, &motion);
        let seen = graph.concat(&[hidden, &context, &motion, &global], 1);
        let hidden = super_kernels(graph, "update_block.gru", &seen, Identity);
        let change = super_kernels(graph, "update_block.flow_head", &hidden, Identity);
        [hidden, change]
    });
    let flow = convex_upsampled(graph, &hidden, &flow);
    pair.output_flow(graph, &flow);
}

/// The weights of attention between pixels with similar context: `[pixels, pixels]`, those of a row sum to 1.
fn attention(graph: &mut Graph, context: &Value) -> Value {
    let channels = context.known(1);
    let both = graph.conv("att.to_qk", context, 1, Identity);
    let queries = graph.channels(&both, 0, channels);
    let queries = graph.scale(&queries, (channels as f32).powf(-0.5));
    let keys = graph.channels(&both, channels, channels);
    let queries = in_rows(graph, &queries);
    let pixels = queries.length(0);
    let keys = graph.reshape(&keys, vec![channels.into(), pixels]);
    let products = graph.product(&queries, &keys);
    graph.softmax(&products, 1)
}

/// A map `[1, channels, height, width]` as `[pixels, channels]`.
fn in_rows(graph: &mut Graph, map: &Value) -> Value {
    let [height, width] = map.size();
    let pixels = graph.times(&height, &width);
    let flat = graph.reshape(map, vec![map.length(1), pixels]);
    graph.transpose(&flat, &[1, 0])
}

/// `Aggregate` of `crate::blocks`.
fn gathered(graph: &mut Graph, weights: &Value, motion: &Value) -> Value {
    let values = graph.conv("update_block.aggregator.to_v", motion, 1, Identity);
    let values = in_rows(graph, &values);
    let gathered = graph.product(weights, &values);
    let gathered = graph.transpose(&gathered, &[1, 0]);
    let gathered = graph.reshape(&gathered, motion.shape());
    let gamma = graph.parameter("update_block.aggregator.gamma");
    let gathered = graph.multiply(&gathered, &gamma);
    graph.add(motion, &gathered)
}

/// `MotionEncoder` of `crate::skflow`.
fn motion(graph: &mut Graph, flow: &Value, windows: &Value) -> Value {
    let correlation = super_kernels(graph, "update_block.encoder.convc1", windows, Gelu);
    let correlation = super_kernels(graph, "update_block.encoder.convc2", &correlation, Identity);
    let motion = graph.conv("update_block.encoder.convf1", flow, 1, Identity);
    let motion = super_kernels(graph, "update_block.encoder.convf2", &motion, Identity);
    let both = graph.concat(&[&correlation, &motion], 1);
    let out = super_kernels(graph, "update_block.encoder.conv", &both, Identity);
    graph.concat(&[&out, flow], 1)
}

/// `SuperKernelBlock` of `crate::skflow`.
fn super_kernels(graph: &mut Graph, name: &str, x: &Value, activation: Activation) -> Value {
    let conv = |graph: &mut Graph, part: &str, x: &Value, activation| {
        graph.conv(&format!("{name}.{part}"), x, 1, activation)
    };
    let residual = |graph: &mut Graph, x: &Value, change: &Value| {
        let sum = graph.add(x, change);
        graph.activated(sum, Gelu)
    };
    let y = conv(graph, "ffn1.0", x, Gelu);
    let y = conv(graph, "ffn1.2", &y, Identity);
    let mut x = residual(graph, x, &y);
    for part in ["conv_list.0", "conv_list.1", "pw"] {
        let y = conv(graph, part, &x, Identity);
        x = residual(graph, &x, &y);
    }
    let y = conv(graph, "ffn2.0", &x, Gelu);
    conv(graph, "ffn2.2", &y, activation)
}
