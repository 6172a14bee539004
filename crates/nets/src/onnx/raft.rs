//! RAFT as a graph: `crate::raft`.

use srflow_ops::Activation::Relu;

use super::Pair;
use super::graph::Graph;
use super::recurrent::{Norm, Parts, begun, convex_upsampled, flow_head, gru_step};
use crate::raft::{HIDDEN, RADIUS};

pub(crate) fn raft(graph: &mut Graph, pair: &Pair, iterations: usize) {
    let parts = Parts { context_norm: Norm::Batch, hidden: HIDDEN as i64, radius: RADIUS };
    let begun = begun(graph, pair, parts);
    let context = begun.context.clone();
    let [hidden, flow] = begun.refined(graph, iterations, |graph, hidden, flow, windows| {
        let conv = |graph: &mut Graph, name: &str, x| {
            graph.conv(&format!("update_block.encoder.{name}"), x, 1, Relu)
        };
        let correlation = conv(graph, "convc1", windows);
        let correlation = conv(graph, "convc2", &correlation);
        let motion = conv(graph, "convf1", flow);
        let motion = conv(graph, "convf2", &motion);
        let both = graph.concat(&[&correlation, &motion], 1);
        let motion = conv(graph, "conv", &both);
        let motion = graph.concat(&[&motion, flow], 1);
        // Along rows, then along columns.
        let mut hidden = hidden.clone();
        for step in [1, 2] {
            let convs = ["convz", "convr", "convq"].map(|conv| format!("update_block.gru.{conv}{step}"));
            hidden = gru_step(graph, convs.each_ref().map(String::as_str), &hidden, &[&context, &motion]);
        }
        let change = flow_head(graph, &hidden);
        [hidden, change]
    });
    let flow = convex_upsampled(graph, &hidden, &flow);
    pair.output_flow(graph, &flow);
}
