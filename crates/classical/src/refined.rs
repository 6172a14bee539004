//! Refines the flow of another estimator.

use srflow_core::{EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image};

use crate::{TvL1, TvL1Parameters};

/// An estimator whose flow is refined by [`TvL1`] at the size of the frames: networks that compute at a part of the size see less than
/// the frames show. Only the flow changes, not its uncertainty.
pub struct Refined {
    estimator: Box<dyn FlowEstimator>,
    refinement: TvL1,
}

impl Refined {
    /// The default parameters: one warp at the size of the frames. More fit the noise.
    pub fn parameters() -> TvL1Parameters {
        TvL1Parameters { nscales: 1, warps: 1, ..TvL1Parameters::default() }
    }

    pub fn new(estimator: Box<dyn FlowEstimator>, refinement: TvL1) -> Self {
        Self { estimator, refinement }
    }

    fn refined(&self, [frame1, frame2]: [&Image; 2], flow: &FlowField) -> Result<FlowField, EstimateError> {
        Ok(self.refinement.estimate_from(frame1, frame2, flow)?.flow)
    }

    fn refine(&self, pair: [&Image; 2], estimate: FlowEstimate) -> Result<FlowEstimate, EstimateError> {
        Ok(FlowEstimate { flow: self.refined(pair, &estimate.flow)?, ..estimate })
    }
}

impl FlowEstimator for Refined {
    fn name(&self) -> &str {
        self.estimator.name()
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        self.refined([frame1, frame2], &self.estimator.estimate(frame1, frame2)?)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let estimates = self.estimator.estimate_pairs(pairs)?;
        pairs.iter().zip(estimates).map(|(pair, estimate)| self.refine(*pair, estimate)).collect()
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        self.refine([frame1, frame2], self.estimator.estimate_from(frame1, frame2, initial)?)
    }

    fn remembers(&self) -> bool {
        self.estimator.remembers()
    }

    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(RefinedSequence { refined: self, sequence: self.estimator.sequence(warm_start), last: None })
    }
}

struct RefinedSequence<'a> {
    refined: &'a Refined,
    sequence: Box<dyn FlowSequence + 'a>,
    last: Option<Image>,
}

impl FlowSequence for RefinedSequence<'_> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let estimates = self.sequence.push(frames)?;
        let video: Vec<&Image> = self.last.iter().chain(frames).collect();
        let pairs = video.windows(2).zip(estimates);
        let refined =
            pairs.map(|(pair, estimate)| self.refined.refine([pair[0], pair[1]], estimate)).collect();
        self.last = frames.last().cloned().or(self.last.take());
        refined
    }

    fn push_pair(&mut self, pair: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        let estimate = self.sequence.push_pair(pair)?;
        self.last = Some(pair[1].clone());
        self.refined.refine(pair, estimate)
    }
}
