//! The network of srflow's own as a graph, but for TV-L1, from whose flow it starts: `crate::srflow`.

use srflow_ops::Activation::{Identity, LeakyRelu, Sigmoid, Tanh};
use srflow_ops::lucas_kanade::{CELL, PER_WINDOW};
use srflow_ops::resize::Grids;

use super::Pair;
use super::graph::{Axis, Graph, Value};
use super::operations::Beyond;
use crate::srflow::{
    DIFFERENCE_SCALE, EVIDENCE, FINE_UP_TO, LOG_SCALE_RANGE, MIXTURE, STATE, STRIDE, WIDTHS, WINDOWS,
};

const CELLS: i64 = STRIDE as i64;

const START: &str = "The flow to start from, between these frames and in their pixels: that of a classical method, such as TV-L1, or that \
                     of the pair before. srflow itself starts from TV-L1 at half of the size.";
const UNCERTAINTY: &str = "The expected error of each component of the flow, in pixels.";

/// A flow in cells, the mixture of its errors, and the state.
struct Found {
    flow: Value,
    mixture: Value,
    state: Value,
}

pub(crate) fn srflow(graph: &mut Graph, pair: &Pair, iterations: usize) {
    let [height, width] = pair.axes();
    let start = graph.input("start", START, &[Axis::Known(1), Axis::Known(2), height, width]);
    let start = pair.extended(graph, &start);
    let start = graph.pooled(&start, CELLS);
    let mut flow = graph.scale(&start, 1.0 / CELLS as f32);
    graph.begin("still");
    let still = still(graph, [&pair.first, &pair.second]);
    let mut state = graph.zeros(flow.with_channels(STATE as i64));
    let mut mixture = None;
    // Of frames of any size it is not known here whether they are small.
    let fine = iterations > 1 && pair.pixels().is_some_and(|pixels| pixels <= FINE_UP_TO);
    for iteration in 1..=iterations - usize::from(fine) {
        graph.begin(format!("iteration_{iteration}"));
        let found = corrected(graph, [&pair.first, &pair.second], &still, [&flow, &state]);
        (flow, state, mixture) = (found.flow, found.state, Some(found.mixture));
    }
    graph.begin("upsampling");
    let mut flow = upsampled(graph, &flow, &state);
    if fine {
        graph.begin("fine");
        let [first, second] =
            [&pair.first, &pair.second].map(|frame| graph.enlarged(frame, CELLS, Grids::EdgesOnEdges));
        let still = self::still(graph, [&first, &second]);
        let state = graph.zeros(flow.with_channels(STATE as i64));
        let found = corrected(graph, [&first, &second], &still, [&flow, &state]);
        let upsampled = upsampled(graph, &found.flow, &found.state);
        let pooled = graph.pooled(&upsampled, CELLS);
        flow = graph.scale(&pooled, 1.0 / CELLS as f32);
    }
    pair.output_flow(graph, &flow);
    if let Some(mixture) = mixture {
        let mixture = graph.enlarged(&mixture, CELLS, Grids::EdgesOnEdges);
        let uncertainty = mean_scale(graph, &mixture);
        pair.output(graph, "uncertainty", UNCERTAINTY, &uncertainty);
    }
}

/// The flow in pixels of an estimate in cells.
fn upsampled(graph: &mut Graph, flow: &Value, state: &Value) -> Value {
    let scores = graph.conv("mask", state, 1, Identity);
    graph.convex_upsampled(flow, &scores, CELLS)
}

/// The estimate that follows on a flow and state.
fn corrected(
    graph: &mut Graph,
    [first, second]: [&Value; 2],
    still: &Value,
    [start, state]: [&Value; 2],
) -> Found {
    let fine = graph.enlarged(start, CELLS, Grids::EdgesOnEdges);
    let fine = graph.scale(&fine, CELLS as f32);
    let warped = warped(graph, second, &fine);
    let evidence = lucas_kanade(graph, first, &warped);
    let difference = graph.subtract(first, &warped);
    let difference = graph.scale(&difference, DIFFERENCE_SCALE as f32);
    let difference = graph.space_to_depth(&difference, CELLS);
    let seen = graph.concat(&[still, &difference, &evidence, start, state], 1);
    // From fine to coarse, with the flow at each size.
    let mut maps = vec![graph.conv("enter", &seen, 1, LeakyRelu)];
    let mut starts = vec![start.clone()];
    for level in 0..WIDTHS.len() - 1 {
        let map = graph.conv(&format!("down.{level}.down"), &maps[level], 2, LeakyRelu);
        maps.push(graph.conv(&format!("down.{level}.same"), &map, 1, LeakyRelu));
        starts.push(graph.pooled(&starts[level], 2));
    }
    let mut coarser: Option<Found> = None;
    for (level, (map, start)) in maps.into_iter().zip(starts).enumerate().rev() {
        // What the coarser size finds besides the start.
        let (state, beside) = match coarser {
            None => (map, graph.scale(&start, -1.0)),
            Some(coarser) => {
                let state = graph.enlarged(&coarser.state, 2, Grids::EdgesOnEdges);
                let flow = graph.enlarged(&coarser.flow, 2, Grids::EdgesOnEdges);
                let beside = graph.subtract(&flow, &start);
                let seen = graph.concat(&[&state, &map, &beside], 1);
                (graph.conv(&format!("up.{level}"), &seen, 1, LeakyRelu), beside)
            }
        };
        let predicted = graph.conv(&format!("predict.{level}"), &state, 1, Identity);
        let share = graph.channels(&predicted, 0, 1);
        let share = graph.activated(share, Tanh);
        let shared = graph.multiply(&beside, &share);
        let flow = graph.add(&start, &shared);
        let change = graph.channels(&predicted, 1, 2);
        let flow = graph.add(&flow, &change);
        let mixture = graph.channels(&predicted, 3, MIXTURE as i64);
        coarser = Some(Found { flow, mixture, state });
    }
    let mut finest = coarser.expect("several sizes");
    let shares = graph.conv("evidence", &finest.state, 1, Tanh);
    for window in 0..WINDOWS as i64 {
        let motion = graph.channels(&evidence, window * PER_WINDOW as i64, 2);
        let motion = graph.scale(&motion, 1.0 / CELL as f32);
        let share = graph.channels(&shares, window, 1);
        let motion = graph.multiply(&motion, &share);
        finest.flow = graph.add(&finest.flow, &motion);
    }
    finest
}

/// `still` of `crate::srflow`.
fn still(graph: &mut Graph, [first, second]: [&Value; 2]) -> Value {
    let pixels = graph.space_to_depth(first, CELLS);
    let change = graph.subtract(first, second);
    let change = graph.mean_of_channels(&change);
    let change = graph.scale(&change, DIFFERENCE_SCALE as f32);
    let change = graph.space_to_depth(&change, CELLS);
    let evidence = lucas_kanade(graph, first, second);
    graph.concat(&[&pixels, &change, &evidence], 1)
}

/// `srflow_ops::warp::tensor::warp_replicated`.
fn warped(graph: &mut Graph, image: &Value, flow: &Value) -> Value {
    let targets = graph.targets(flow);
    let targets = graph.transpose(&targets, &[0, 2, 3, 1]);
    let scale = graph.sampling_scale(image.size());
    let positions = graph.multiply(&targets, &scale);
    let positions = graph.shift(&positions, -1.0);
    graph.sampled(image, &positions, Beyond::Border)
}

/// `srflow_ops::lucas_kanade`, by [`EVIDENCE`].
fn lucas_kanade(graph: &mut Graph, first: &Value, second: &Value) -> Value {
    let [first, second] = [first, second].map(|frame| graph.mean_of_channels(frame));
    let t = graph.subtract(&second, &first);
    let sum = graph.add(&first, &second);
    let mean = graph.scale(&sum, 0.5);
    let [x, y] = graph.slopes(&mean);
    let products = [(&x, &x), (&x, &y), (&y, &y), (&x, &t), (&y, &t)].map(|(a, b)| graph.multiply(a, b));
    let products = graph.concat(&products.each_ref(), 1);
    let products = graph.pooled(&products, CELL as i64);
    let mut found = Vec::new();
    for radius in EVIDENCE.radii {
        let means = graph.smoothed(&products, radius as i64);
        let [xx, xy, yy, xt, yt] = [0, 1, 2, 3, 4].map(|product| graph.channels(&means, product, 1));
        let [noisy_xx, noisy_yy] = [&xx, &yy].map(|mean| graph.shift(mean, EVIDENCE.noise));
        let both = graph.multiply(&noisy_xx, &noisy_yy);
        let mixed = graph.multiply(&xy, &xy);
        let determinant = graph.subtract(&both, &mixed);
        // u is (xy yt - yy xt) / determinant, v is (xy xt - xx yt) / determinant.
        for ([a, b], [c, d]) in [([&xy, &yt], [&noisy_yy, &xt]), ([&xy, &xt], [&noisy_xx, &yt])] {
            let (more, less) = (graph.multiply(a, b), graph.multiply(c, d));
            let numerator = graph.subtract(&more, &less);
            let component = graph.divide(&numerator, &determinant);
            found.push(graph.clamped(&component, -EVIDENCE.reach, EVIDENCE.reach));
        }
        for (mean, noisy) in [(&xx, &noisy_xx), (&yy, &noisy_yy)] {
            found.push(graph.divide(mean, noisy));
        }
    }
    graph.concat(&found.iter().collect::<Vec<_>>(), 1)
}

/// [`LaplaceMixture::mean_scale`](crate::LaplaceMixture::mean_scale) of the logarithms of weights, then of scales.
fn mean_scale(graph: &mut Graph, mixture: &Value) -> Value {
    let [wide_weight, narrow_weight, wide, narrow] = [0, 1, 2, 3].map(|at| graph.channels(mixture, at, 1));
    let [low, high] = LOG_SCALE_RANGE.map(|limit| limit as f32);
    let wide = graph.clamped(&wide, 0.0, high);
    let narrow = graph.clamped(&narrow, low, 0.0);
    let [wide, narrow] = [wide, narrow].map(|scale| graph.each("Exp", &scale));
    let share = graph.subtract(&wide_weight, &narrow_weight);
    let share = graph.activated(share, Sigmoid);
    let more = graph.subtract(&wide, &narrow);
    let more = graph.multiply(&share, &more);
    graph.add(&narrow, &more)
}
