//! The iterations at one level: compute the evidence, average it over the window, and solve for a new flow.
//!
//! Each strip of columns is processed row by row, and keeps only as many rows of evidence as the window is high.

use rayon::prelude::*;

use super::evidence::{CHANNELS, EvidenceRows};
use super::expansion::Expansion;
use super::strips::{Strip, StripedFlow};
use super::window::{Averager, Window};
use crate::planar::PlanarFlow;
use srflow_simd::multiversioned;

/// Strips per thread: more than one, to balance the load.
const STRIPS_PER_THREAD: usize = 2;

/// Runs `iterations` of the update at one level of the pyramid.
pub fn iterate(
    expansions: (&Expansion, &Expansion),
    flow: &PlanarFlow,
    window: &Window,
    iterations: usize,
) -> PlanarFlow {
    // The cut into strips does not change the result, and few wide strips are read from memory faster.
    let mut flow = StripedFlow::cut(flow, STRIPS_PER_THREAD * rayon::current_num_threads());
    let mut updated = flow.clone();
    let mut scratch: Vec<Scratch> =
        flow.strips.iter().map(|strip| Scratch::new(strip, &flow, window)).collect();
    for _ in 0..iterations {
        let strips = updated.strips.par_iter_mut().zip(&mut scratch);
        strips.for_each(|(strip, scratch)| scratch.update(strip, expansions, &flow));
        std::mem::swap(&mut flow, &mut updated);
    }
    PlanarFlow::from(&flow)
}

/// Buffers for the update of a strip.
struct Scratch {
    evidence: EvidenceRows,
    averager: Averager,
    averages: Vec<f64>,
}

impl Scratch {
    fn new(strip: &Strip, flow: &StripedFlow, window: &Window) -> Self {
        Self {
            evidence: EvidenceRows::new(strip.columns(), flow.width, flow.height, window.radius),
            averager: Averager::new(window),
            averages: vec![0.0; strip.width * CHANNELS],
        }
    }

    /// Writes the new flow of a strip.
    fn update(&mut self, strip: &mut Strip, expansions: (&Expansion, &Expansion), flow: &StripedFlow) {
        let rows = strip.u.chunks_exact_mut(strip.width).zip(strip.v.chunks_exact_mut(strip.width));
        self.evidence.restart();
        for (y, (u, v)) in rows.enumerate() {
            self.evidence.gather_for(y, expansions, flow);
            self.averager.average(&mut self.averages, &self.evidence, y);
            solve(u, v, &self.averages);
        }
    }
}

multiversioned! {
    /// Solves `G d = h` for a row; a small constant added to the determinant handles areas without texture.
    fn solve(u: &mut [f32], v: &mut [f32], averages: &[f64]) {
        let len = u.len();
        let channel = |i: usize| &averages[i * len..(i + 1) * len];
        let [g_yy, g_xy, g_xx, h_y, h_x] = [0, 1, 2, 3, 4].map(channel);
        let v = &mut v[..len];
        for x in 0..len {
            let inverse = 1.0 / (g_yy[x] * g_xx[x] - g_xy[x] * g_xy[x] + 1e-3);
            u[x] = ((g_yy[x] * h_x[x] - g_xy[x] * h_y[x]) * inverse) as f32;
            v[x] = ((g_xx[x] * h_y[x] - g_xy[x] * h_x[x]) * inverse) as f32;
        }
    }
}
