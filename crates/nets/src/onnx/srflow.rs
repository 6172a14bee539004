//! The network of srflow's own as a graph, but for TV-L1, from whose flow it starts: `crate::srflow`.

use srflow_ops::Activation::{Identity, LeakyRelu, Relu, Sigmoid, Tanh};
use srflow_ops::lucas_kanade::{CELL, PER_WINDOW};
use srflow_ops::resize::Grids;

use super::Pair;
use super::graph::{Axis, Graph, Value};
use super::operations::Beyond;
use crate::srflow::{
    AROUND, DIFFERENCE_SCALE, EVIDENCE, FINE_UP_TO, LOG_SCALE_RANGE, MIXTURE, SEEN_CELLS, STRIDE, WIDTHS,
    WINDOWS, WORSE_BY, WORSE_FACTOR,
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
    let mut found = None;
    let mut kept: Option<Explained> = None;
    let frames = [&pair.first, &pair.second];
    // Of frames of any size it is not known here whether they are small.
    let fine = iterations > 1 && pair.pixels().is_some_and(|pixels| pixels <= FINE_UP_TO);
    for iteration in 1..=iterations - usize::from(fine) {
        graph.begin(format!("iteration_{iteration}"));
        let explained = Explained::by(graph, frames, flow);
        let explained = match kept.take() {
            Some(before) => explained.or(graph, before),
            None => explained,
        };
        let corrected = corrected(graph, &pair.first, &still, &explained.flow, &explained.warped);
        flow = corrected.flow.clone();
        (found, kept) = (Some(corrected), Some(explained));
    }
    let (Some(found), Some(kept)) = (found, kept) else { panic!("at least one iteration") };
    graph.begin("upsampling");
    let mut flow = upsampled(graph, &found.flow, &found.state);
    if fine {
        graph.begin("fine");
        let [first, second] =
            [&pair.first, &pair.second].map(|frame| graph.enlarged(frame, CELLS, Grids::EdgesOnEdges));
        let still = self::still(graph, [&first, &second]);
        let warped = warped_by_cells(graph, &second, &flow);
        let found = corrected(graph, &first, &still, &flow, &warped);
        let upsampled = upsampled(graph, &found.flow, &found.state);
        let pooled = graph.pooled(&upsampled, CELLS);
        flow = graph.scale(&pooled, 1.0 / CELLS as f32);
    }
    graph.begin("kept");
    let flow = kept.or_flow(graph, frames, &flow);
    pair.output_flow(graph, &flow);
    let mixture = graph.enlarged(&found.mixture, CELLS, Grids::EdgesOnEdges);
    let uncertainty = mean_scale(graph, &mixture);
    pair.output(graph, "uncertainty", UNCERTAINTY, &uncertainty);
}

/// `Explained` of `crate::srflow`.
struct Explained {
    flow: Value,
    warped: Value,
    residual: Value,
}

impl Explained {
    fn by(graph: &mut Graph, [first, second]: [&Value; 2], flow: Value) -> Self {
        let warped = warped_by_cells(graph, second, &flow);
        let residual = residual(graph, first, &warped);
        Self { flow, warped, residual }
    }

    fn or(self, graph: &mut Graph, before: Self) -> Self {
        let worse = is_worse(graph, &self.residual, &before.residual);
        let worse_pixels = graph.repeated(&worse, CELLS);
        Self {
            flow: graph.blended(&worse, &before.flow, &self.flow),
            warped: graph.blended(&worse_pixels, &before.warped, &self.warped),
            residual: graph.pairs("Min", &self.residual, &before.residual),
        }
    }

    fn or_flow(&self, graph: &mut Graph, [first, second]: [&Value; 2], found: &Value) -> Value {
        let warped = warped(graph, second, found);
        let residual = residual(graph, first, &warped);
        let worse = is_worse(graph, &residual, &self.residual);
        let worse = graph.repeated(&worse, CELLS);
        let flow = in_pixels(graph, &self.flow);
        graph.blended(&worse, &flow, found)
    }
}

fn is_worse(graph: &mut Graph, residual: &Value, before: &Value) -> Value {
    let before = graph.scale(before, WORSE_FACTOR as f32);
    let limit = graph.shift(&before, WORSE_BY as f32);
    graph.greater(residual, &limit)
}

fn residual(graph: &mut Graph, first: &Value, warped: &Value) -> Value {
    let difference = graph.subtract(first, warped);
    let difference = graph.each("Abs", &difference);
    let difference = graph.mean_of_channels(&difference);
    let of_cells = graph.pooled(&difference, CELLS);
    graph.smoothed(&of_cells, AROUND as i64)
}

/// A flow in cells as one of pixels.
fn in_pixels(graph: &mut Graph, flow: &Value) -> Value {
    let fine = graph.enlarged(flow, CELLS, Grids::EdgesOnEdges);
    graph.scale(&fine, CELLS as f32)
}

fn warped_by_cells(graph: &mut Graph, second: &Value, flow: &Value) -> Value {
    let flow = in_pixels(graph, flow);
    warped(graph, second, &flow)
}

/// `seen_flow` of `crate::srflow`.
fn seen_flow(graph: &mut Graph, flow: &Value) -> Value {
    let squared = graph.multiply(flow, flow);
    let squared = graph.scale(&squared, (1.0 / (SEEN_CELLS * SEEN_CELLS)) as f32);
    let squared = graph.shift(&squared, 1.0);
    let length = graph.each("Sqrt", &squared);
    graph.divide(flow, &length)
}

/// The flow in pixels of an estimate in cells.
fn upsampled(graph: &mut Graph, flow: &Value, state: &Value) -> Value {
    let scores = graph.conv("mask", state, 1, Identity);
    let flow = graph.convex_upsampled(flow, &scores, CELLS);
    // `without_lattice` of `crate::srflow`.
    graph.binomial(&flow)
}

/// The estimate that follows on a flow, by which frame 2 is warped.
fn corrected(graph: &mut Graph, first: &Value, still: &Value, start: &Value, warped: &Value) -> Found {
    let evidence = lucas_kanade(graph, first, warped);
    let difference = graph.subtract(first, warped);
    let difference = graph.scale(&difference, DIFFERENCE_SCALE as f32);
    let difference = graph.space_to_depth(&difference, CELLS);
    let flow = seen_flow(graph, start);
    let seen = graph.concat(&[still, &difference, &evidence, &flow], 1);
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
                let seen_beside = seen_flow(graph, &beside);
                let seen = graph.concat(&[&state, &map, &seen_beside], 1);
                (graph.conv(&format!("up.{level}"), &seen, 1, LeakyRelu), beside)
            }
        };
        let predicted = graph.conv(&format!("predict.{level}"), &state, 1, Identity);
        let share = graph.channels(&predicted, 0, 1);
        let share = graph.activated(share, Tanh);
        let share = graph.activated(share, Relu);
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
