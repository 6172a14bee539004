use srflow_core::{EstimateError, FlowEstimate, FlowEstimator, FlowField, Image};

use crate::estimator::NetworkEstimator;

/// A network that starts each pair from the flow of another method.
pub struct Started {
    network: NetworkEstimator,
    start: Box<dyn FlowEstimator>,
}

impl Started {
    /// The network must be able to start from a flow: see [`Start`](crate::Start).
    pub fn new(network: NetworkEstimator, start: Box<dyn FlowEstimator>) -> Self {
        Self { network, start }
    }
}

impl FlowEstimator for Started {
    fn name(&self) -> &str {
        self.network.name()
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_from(frame1, frame2, &self.start.estimate(frame1, frame2)?)?.flow)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let starts = self.start.estimate_pairs(pairs)?;
        let pairs = pairs.iter().zip(starts);
        pairs.map(|([frame1, frame2], start)| self.estimate_from(frame1, frame2, &start.flow)).collect()
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        self.network.estimate_from(frame1, frame2, initial)
    }
}
