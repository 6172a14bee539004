//! Gunnar Farneback's method: *Two-Frame Motion Estimation Based on Polynomial Expansion*, SCIA 2003.
//!
//! The behaviour is defined by `modules/video/src/optflowgf.cpp` of OpenCV.

mod evidence;
mod expansion;
mod pyramid;
#[cfg(test)]
mod reference;
mod strips;
mod update;
mod window;

use serde::Serialize;
use srflow_core::resize::{resize_linear_of_two, shrink_area};
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image, Size, check_frame_sizes,
    forward_interpolate, luminance,
};

use crate::ParameterError;
use crate::planar::PlanarFlow;
use expansion::{Expansion, ExpansionKernel};
use update::iterate;
use window::Window;

const NAME: &str = "farneback";

/// The shortest side of a coarser pyramid level, in pixels.
const SMALLEST_SIDE: f64 = 32.0;

/// The parameters of OpenCV's `calcOpticalFlowFarneback`, under its names. The defaults are those of
/// `FarnebackOpticalFlow::create`. The flag `OPTFLOW_USE_INITIAL_FLOW` is [`FlowEstimator::estimate_from`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FarnebackParameters {
    /// Size of a pyramid level relative to the next finer one, between 0 and 1.
    pub pyr_scale: f64,
    /// Number of pyramid levels beside the full-size one; levels under 32 pixels a side are left out.
    pub levels: usize,
    /// Side of the averaging window in pixels. Larger is smoother and more robust.
    pub winsize: usize,
    /// Iterations at each level.
    pub iterations: usize,
    /// Radius in pixels of the neighbourhood that a polynomial is fitted to; 5 or 7 is usual.
    pub poly_n: usize,
    /// Standard deviation in pixels of the Gaussian that weights the fit; 1.1 goes with 5 and 1.5 with 7.
    pub poly_sigma: f64,
    /// `OPTFLOW_FARNEBACK_GAUSSIAN`: average with a Gaussian of `0.3 * (winsize / 2)` in place of a box.
    pub gaussian: bool,
}

impl Default for FarnebackParameters {
    fn default() -> Self {
        Self {
            pyr_scale: 0.5,
            levels: 5,
            winsize: 13,
            iterations: 10,
            poly_n: 5,
            poly_sigma: 1.1,
            gaussian: false,
        }
    }
}

impl FarnebackParameters {
    fn check(&self) -> Result<(), ParameterError> {
        let must = |valid: bool, parameter, expected, found| {
            if valid { Ok(()) } else { Err(ParameterError { method: NAME, parameter, expected, found }) }
        };
        let inside = self.pyr_scale > 0.0 && self.pyr_scale < 1.0;
        must(inside, "pyr_scale", "above 0 and below 1", self.pyr_scale)?;
        must((2..=1023).contains(&self.winsize), "winsize", "between 2 and 1023", self.winsize as f64)?;
        must(self.iterations <= 1000, "iterations", "at most 1000", self.iterations as f64)?;
        must((1..=63).contains(&self.poly_n), "poly_n", "between 1 and 63", self.poly_n as f64)?;
        let finite = self.poly_sigma >= 0.0 && self.poly_sigma.is_finite();
        must(finite, "poly_sigma", "0 (for 0.3 poly_n) or more", self.poly_sigma)
    }
}

/// Farneback's method with OpenCV's parameters.
#[derive(Debug, Clone)]
pub struct Farneback {
    parameters: FarnebackParameters,
    kernel: ExpansionKernel,
    window: Window,
}

impl Farneback {
    /// # Errors
    /// When a parameter is out of its range.
    pub fn new(parameters: FarnebackParameters) -> Result<Self, ParameterError> {
        parameters.check()?;
        let kernel =
            ExpansionKernel::new(parameters.poly_n, parameters.poly_sigma).ok_or(ParameterError {
                method: NAME,
                parameter: "poly_sigma",
                expected: "large enough that a polynomial can be fitted: about 0.3 poly_n",
                found: parameters.poly_sigma,
            })?;
        let window = Window::new(parameters.winsize, parameters.gaussian);
        Ok(Self { parameters, kernel, window })
    }

    fn flow(&self, frame1: &Image, frame2: &Image, initial: Option<&FlowField>) -> FlowField {
        let [first, second] = [frame1, frame2].map(|frame| self.expanded(frame));
        self.between(&first, &second, initial)
    }

    fn expanded(&self, frame: &Image) -> Expanded {
        let size = frame.size();
        let frame = luminance(frame);
        let levels = self.level_sizes(size).into_iter().map(|(scale, size)| {
            let expansion = Expansion::of(&pyramid::level(&frame, size, scale), &self.kernel);
            (scale, expansion)
        });
        Expanded { size, levels: levels.collect() }
    }

    /// The flow between frames of one size.
    fn between(&self, first: &Expanded, second: &Expanded, initial: Option<&FlowField>) -> FlowField {
        let mut flow: Option<PlanarFlow> = None;
        for ((scale, first), (_, second)) in first.levels.iter().zip(&second.levels).rev() {
            let size = Size::new(first.width, first.height);
            let start = match (flow, initial) {
                (Some(coarser), _) => {
                    let gain = (1.0 / self.parameters.pyr_scale) as f32;
                    coarser.map(|plane| resize_linear_of_two(plane, size, gain))
                }
                (None, Some(initial)) => {
                    PlanarFlow::from(initial).map(|plane| shrink_area(plane, size, *scale as f32))
                }
                (None, None) => PlanarFlow::zero(size.width, size.height),
            };
            flow = Some(iterate((first, second), &start, &self.window, self.parameters.iterations));
        }
        flow.map_or_else(|| FlowField::new(0, 0), FlowField::from)
    }

    /// Scale and size of each level, the full size first.
    fn level_sizes(&self, Size { width, height }: Size) -> Vec<(f64, Size)> {
        let mut levels = Vec::new();
        let mut scale = 1.0;
        for level in 0..=self.parameters.levels {
            let (level_width, level_height) = (width as f64 * scale, height as f64 * scale);
            if level > 0 && level_width.min(level_height) < SMALLEST_SIDE {
                break;
            }
            let size =
                Size::new(level_width.round_ties_even() as usize, level_height.round_ties_even() as usize);
            levels.push((scale, size));
            scale *= self.parameters.pyr_scale;
        }
        levels
    }
}

/// What the method computes of a single frame: its expansion at the scale of each level, the full size first.
struct Expanded {
    size: Size,
    levels: Vec<(f64, Expansion)>,
}

impl FlowEstimator for Farneback {
    fn name(&self) -> &str {
        NAME
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        check_frame_sizes(frame1.size(), [frame2.size()])?;
        Ok(self.flow(frame1, frame2, None))
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        check_frame_sizes(frame1.size(), [frame2.size(), initial.size()])?;
        Ok(self.flow(frame1, frame2, Some(initial)).into())
    }

    /// Expands each frame once for its two pairs.
    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(Video { farneback: self, warm_start, last: None, flow: None })
    }
}

struct Video<'a> {
    farneback: &'a Farneback,
    warm_start: bool,
    last: Option<Expanded>,
    /// The flow of the previous pair, for a warm start.
    flow: Option<FlowField>,
}

impl FlowSequence for Video<'_> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let mut estimates = Vec::with_capacity(frames.len());
        for frame in frames {
            if let Some(last) = self.last.take() {
                check_frame_sizes(last.size, [frame.size()])?;
                estimates.push(self.next(&last, frame));
            } else {
                self.last = Some(self.farneback.expanded(frame));
            }
        }
        Ok(estimates)
    }

    fn push_pair(&mut self, [first, second]: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        check_frame_sizes(first.size(), [second.size()])?;
        let first = self.farneback.expanded(first);
        Ok(self.next(&first, second))
    }
}

impl Video<'_> {
    fn next(&mut self, first: &Expanded, second: &Image) -> FlowEstimate {
        let second = self.farneback.expanded(second);
        let initial = self.flow.as_ref().map(forward_interpolate);
        let flow = self.farneback.between(first, &second, initial.as_ref());
        if self.warm_start {
            self.flow = Some(flow.clone());
        }
        self.last = Some(second);
        flow.into()
    }
}
