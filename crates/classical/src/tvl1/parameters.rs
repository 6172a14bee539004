//! The parameters of TV-L1, and their ranges.

use serde::Serialize;

use crate::ParameterError;

pub(super) const NAME: &str = "tvl1";

/// The parameters of OpenCV's `DualTVL1OpticalFlow`, with its defaults. `useInitialFlow` is
/// [`FlowEstimator::estimate_from`](srflow_core::FlowEstimator::estimate_from).
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
    pub(super) fn check(&self) -> Result<(), ParameterError> {
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
