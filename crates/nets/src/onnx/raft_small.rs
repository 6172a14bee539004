//! RAFT-S as a graph: `crate::raft_small`.

use srflow_ops::Activation::Relu;
use srflow_ops::resize::Grids;

use super::Pair;
use super::graph::Graph;
use super::recurrent::{Norm, Parts, begun, flow_head, gru_step};
use crate::raft_small::{HIDDEN, RADIUS};
use crate::recurrent::STRIDE;

pub(crate) fn raft_small(graph: &mut Graph, pair: &Pair, iterations: usize) {
    let parts = Parts { context_norm: Norm::None, hidden: HIDDEN as i64, radius: RADIUS };
    let begun = begun(graph, pair, parts);
    let context = begun.context.clone();
    let [_, flow] = begun.refined(graph, iterations, |graph, hidden, flow, windows| {
        let conv = |graph: &mut Graph, name: &str, x| {
            graph.conv(&format!("update_block.encoder.{name}"), x, 1, Relu)
        };
        let correlation = conv(graph, "convc1", windows);
        let motion = conv(graph, "convf1", flow);
        let motion = conv(graph, "convf2", &motion);
        let both = graph.concat(&[&correlation, &motion], 1);
        let motion = conv(graph, "conv", &both);
        let motion = graph.concat(&[&motion, flow], 1);
        let convs = ["update_block.gru.convz", "update_block.gru.convr", "update_block.gru.convq"];
        let hidden = gru_step(graph, convs, hidden, &[&context, &motion]);
        let change = flow_head(graph, &hidden);
        [hidden, change]
    });
    let flow = graph.enlarged(&flow, STRIDE as i64, Grids::CornersOnCorners);
    let flow = graph.scale(&flow, STRIDE as f32);
    pair.output_flow(graph, &flow);
}
