//! TV-L1 optical flow: Zach, Pock and Bischof, *A Duality Based Approach for Realtime TV-L1 Optical Flow*, DAGM 2007, in
//! the form of Sanchez, Meinhardt-Llopis and Facciolo, *TV-L1 Optical Flow Estimation*, IPOL 2013.
//!
//! The behaviour is defined by `modules/optflow/src/tvl1flow.cpp` of opencv_contrib.

mod median;
mod parameters;
#[cfg(test)]
mod reference;
mod relaxation;
mod state;
mod warp;

use srflow_core::resize::{resize_linear, resize_linear_by};
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, Image, Plane, Size, check_frame_sizes, luminance,
};

use crate::ParameterError;
use crate::planar::PlanarFlow;
use parameters::NAME;
pub use parameters::TvL1Parameters;
use relaxation::Relaxation;
use state::{Layout, State};
use warp::Warper;

/// The shortest side of a coarser scale, in pixels.
const SMALLEST_SIDE: usize = 16;

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
            let coarser = resize_linear_by(finer, Size { width, height }, 1.0 / step, 1.0);
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
