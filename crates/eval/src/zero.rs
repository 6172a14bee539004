use srflow_core::{EstimateError, FlowEstimator, FlowField, Image, check_frame_sizes};

/// The estimator of zero flow: its EPE is the mean length of the true flow, and a method that does not beat it has detected
/// no motion.
#[derive(Debug, Clone, Copy, Default)]
pub struct Zero;

impl FlowEstimator for Zero {
    fn name(&self) -> &str {
        "zero"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        check_frame_sizes(frame1.size(), [frame2.size()])?;
        Ok(FlowField::new(frame1.width(), frame1.height()))
    }
}
