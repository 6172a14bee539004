use crate::{FlowField, Image};

/// Anything that computes optical flow between two frames: a classical method or a network.
pub trait FlowEstimator: Send + Sync {
    /// The name that tables and `--method` use, e.g. `farneback`.
    fn name(&self) -> &str;

    /// Flow from `frame1` to `frame2`, of their size. Every pixel of the result is finite.
    ///
    /// # Errors
    /// When the frames differ in size or the method cannot work at that size.
    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError>;

    /// Like [`estimate`](Self::estimate), starting from a flow that is already about right, of the frames' size.
    ///
    /// # Errors
    /// Beside those of `estimate`, when the method cannot start from a flow.
    fn estimate_from(
        &self,
        _frame1: &Image,
        _frame2: &Image,
        _initial: &FlowField,
    ) -> Result<FlowField, EstimateError> {
        Err(EstimateError::Unsupported {
            method: self.name().to_owned(),
            reason: "cannot start from an initial flow; leave it out".to_owned(),
        })
    }
}

/// Why a [`FlowEstimator`] gave no flow.
#[derive(Debug, thiserror::Error)]
pub enum EstimateError {
    /// The two frames differ in size.
    #[error("the frames differ in size: the first is {}x{}, the second {}x{} (WIDTHxHEIGHT)", .first.0, .first.1, .second.0, .second.1)]
    SizeMismatch {
        /// Width and height of the first frame.
        first: (usize, usize),
        /// Width and height of the second frame.
        second: (usize, usize),
    },
    /// The method cannot work on these frames or with these parameters.
    #[error("{method}: {reason}")]
    Unsupported {
        /// Name of the method.
        method: String,
        /// What is wrong and what to do.
        reason: String,
    },
}
