use srflow_field::{EstimateError, FlowEstimator, FlowField, Image};

/// The estimator that says nothing moves: its EPE is the mean length of the true flow, so that a method which does not
/// beat it has seen no motion.
#[derive(Debug, Clone, Copy, Default)]
pub struct Zero;

impl FlowEstimator for Zero {
    fn name(&self) -> &str {
        "zero"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        if frame1.size() != frame2.size() {
            return Err(EstimateError::SizeMismatch { first: frame1.size(), second: frame2.size() });
        }
        Ok(FlowField::new(frame1.width(), frame1.height()))
    }
}
