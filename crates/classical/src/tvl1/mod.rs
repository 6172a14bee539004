//! TV-L1 optical flow: Zach, Pock and Bischof, *A Duality Based Approach for Realtime TV-L1 Optical Flow*, DAGM 2007, in
//! the form of Sanchez, Meinhardt-Llopis and Facciolo, *TV-L1 Optical Flow Estimation*, IPOL 2013.
//!
//! The behaviour is defined by `modules/optflow/src/tvl1flow.cpp` of opencv_contrib.

mod median;
#[cfg(test)]
mod reference;
mod relaxation;
mod state;
mod warp;

use serde::Serialize;
use srflow_core::resize::{resize_linear, resize_linear_by};
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, Image, Plane, check_frame_sizes, luminance,
};

use crate::ParameterError;
use crate::planar::PlanarFlow;
use relaxation::Relaxation;
use state::{Layout, State};
use warp::Warper;

const NAME: &str = "tvl1";

/// The shortest side of a coarser scale, in pixels.
const SMALLEST_SIDE: usize = 16;

/// The parameters of OpenCV's `DualTVL1OpticalFlow`, with its defaults. `useInitialFlow` is
/// [`FlowEstimator::estimate_from`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TvL1Parameters {
    /// Time step of the dual update.
    pub tau: f64,
    /// Weight of the data term: smaller is smoother.
    pub lambda: f64,
    /// Tightness of the coupling between the data term and smoothness.
    pub theta: f64,
    /// Number of scales.
    pub nscales: usize,
    /// How often the second frame is warped at each scale.
    pub warps: usize,
    /// The iterations of a warp stop when the mean squared change of the flow is under `epsilon^2` pixels.
    pub epsilon: f64,
    /// Iterations between two median filters.
    pub inner_iterations: usize,
    /// Median filters after each warp.
    pub outer_iterations: usize,
    /// Size of a scale relative to the next finer one, between 0 and 1.
    pub scale_step: f64,
    /// Weight of an additional brightness change; 0 estimates none.
    pub gamma: f64,
    /// Side of the median filter in pixels: 3 or 5, or 1 for none.
    pub median_filtering: usize,
}

impl Default for TvL1Parameters {
    fn default() -> Self {
        Self {
            tau: 0.25,
            lambda: 0.15,
            theta: 0.3,
            nscales: 5,
            warps: 5,
            epsilon: 0.01,
            inner_iterations: 30,
            outer_iterations: 10,
            scale_step: 0.8,
            gamma: 0.0,
            median_filtering: 5,
        }
    }
}

impl TvL1Parameters {
    fn check(&self) -> Result<(), ParameterError> {
        let must = |valid: bool, parameter, expected, found| {
            if valid { Ok(()) } else { Err(ParameterError { method: NAME, parameter, expected, found }) }
        };
        let positive = |value: f64| value > 0.0 && value <= 1e4;
        let count = |value: usize| (1..=10_000).contains(&value);
        must(positive(self.tau), "tau", "above 0 and at most 10000", self.tau)?;
        must(positive(self.lambda), "lambda", "above 0 and at most 10000", self.lambda)?;
        must(positive(self.theta), "theta", "above 0 and at most 10000", self.theta)?;
        must(count(self.nscales), "nscales", "between 1 and 10000", self.nscales as f64)?;
        must(count(self.warps), "warps", "between 1 and 10000", self.warps as f64)?;
        must((0.0..=1e4).contains(&self.epsilon), "epsilon", "between 0 and 10000", self.epsilon)?;
        let inner = self.inner_iterations;
        must(count(inner), "innerIterations", "between 1 and 10000", inner as f64)?;
        let outer = self.outer_iterations;
        must(count(outer), "outerIterations", "between 1 and 10000", outer as f64)?;
        let inside = self.scale_step > 0.0 && self.scale_step < 1.0;
        must(inside, "scaleStep", "above 0 and below 1", self.scale_step)?;
        must((0.0..=1e4).contains(&self.gamma), "gamma", "between 0 and 10000", self.gamma)?;
        let side = self.median_filtering;
        must([1, 3, 5].contains(&side), "medianFiltering", "1 (none), 3 or 5", side as f64)
    }
}

/// TV-L1 with OpenCV's parameters.
#[derive(Debug, Clone)]
pub struct TvL1 {
    parameters: TvL1Parameters,
}

impl TvL1 {
    /// # Errors
    /// When a parameter is out of its range.
    pub fn new(parameters: TvL1Parameters) -> Result<Self, ParameterError> {
        parameters.check()?;
        Ok(Self { parameters })
    }

    /// The flow between two planes of luminance in 0 to 255, which need not be whole numbers.
    ///
    /// # Errors
    /// When the planes differ in size.
    pub fn between_planes(&self, first: Plane, second: Plane) -> Result<FlowField, EstimateError> {
        check_frame_sizes(first.size(), [second.size()])?;
        Ok(self.flow([first, second], None))
    }

    fn flow(&self, frames: [Plane; 2], initial: Option<&FlowField>) -> FlowField {
        if frames[0].pixels().is_empty() {
            return FlowField::new(frames[0].width(), frames[0].height());
        }
        let [first, second] = &frames.map(|frame| self.scales(frame));
        let coarsest = first.len() - 1;
        let mut flow = match initial {
            Some(initial) => (0..coarsest).fold(PlanarFlow::from(initial), |flow, scale| {
                let step = self.parameters.scale_step;
                flow.map(|plane| resize_linear_by(plane, first[scale + 1].size(), 1.0 / step, step as f32))
            }),
            None => PlanarFlow::zero(first[coarsest].width(), first[coarsest].height()),
        };
        let mut brightness =
            (self.parameters.gamma > 0.0).then(|| Plane::new(flow.u.width(), flow.u.height()));
        for scale in (0..=coarsest).rev() {
            let size = first[scale].size();
            if flow.u.size() != size {
                let gain = (1.0 / self.parameters.scale_step) as f32;
                flow = flow.map(|plane| resize_linear(plane, size, gain));
                brightness = brightness.map(|plane| resize_linear(&plane, size, 1.0));
            }
            (flow, brightness) = self.refine(&first[scale], &second[scale], &flow, brightness.as_ref());
        }
        FlowField::from(flow)
    }

    /// The frame at every scale, the finest first.
    fn scales(&self, frame: Plane) -> Vec<Plane> {
        let step = self.parameters.scale_step;
        let mut scales = vec![frame];
        while scales.len() < self.parameters.nscales {
            let finer = &scales[scales.len() - 1];
            let [width, height] =
                [finer.width(), finer.height()].map(|side| (side as f64 * step).round_ties_even() as usize);
            if width.min(height) < SMALLEST_SIDE {
                break;
            }
            let coarser = resize_linear_by(finer, (width, height), 1.0 / step, 1.0);
            scales.push(coarser);
        }
        scales
    }

    /// The flow (and brightness change) at one scale, starting from the coarser one.
    fn refine(
        &self,
        first: &Plane,
        second: &Plane,
        flow: &PlanarFlow,
        brightness: Option<&Plane>,
    ) -> (PlanarFlow, Option<Plane>) {
        let parameters = &self.parameters;
        let layout = Layout::new(first.width(), first.height(), brightness.is_some());
        let mut relaxation = Relaxation::new(State::new(layout, flow, brightness), parameters);
        let warper = Warper::new(second);
        let limit = parameters.epsilon * parameters.epsilon * (first.width() * first.height()) as f64;
        for _ in 0..parameters.warps {
            warper.linearize(&mut relaxation.linearized, first, &relaxation.state);
            let mut change = f64::INFINITY;
            for _ in 0..parameters.outer_iterations {
                if parameters.median_filtering > 1 {
                    relaxation.filter(parameters.median_filtering);
                }
                change = relaxation.run(parameters.inner_iterations, limit, change);
                if change <= limit {
                    break;
                }
            }
        }
        relaxation.state.into_planes()
    }
}

impl FlowEstimator for TvL1 {
    fn name(&self) -> &str {
        NAME
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        check_frame_sizes(frame1.size(), [frame2.size()])?;
        Ok(self.flow([frame1, frame2].map(luminance), None))
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        check_frame_sizes(frame1.size(), [frame2.size(), initial.size()])?;
        Ok(self.flow([frame1, frame2].map(luminance), Some(initial)).into())
    }
}
