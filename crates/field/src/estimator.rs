use crate::{FlowField, Image, forward_interpolate};

/// Anything that computes optical flow between two frames: a classical method or a network.
pub trait FlowEstimator: Send + Sync {
    /// The name that tables and `--method` use, e.g. `farneback`.
    fn name(&self) -> &str;

    /// Flow from `frame1` to `frame2`, of their size. Every pixel of the result is finite.
    ///
    /// # Errors
    /// When the frames differ in size or the method cannot work at that size.
    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError>;

    /// The flow of each of these pairs, all of one size. A method that can estimates them at once.
    ///
    /// # Errors
    /// As [`estimate`](Self::estimate), when one of the pairs has no flow.
    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowField>, EstimateError> {
        pairs.iter().map(|[frame1, frame2]| self.estimate(frame1, frame2)).collect()
    }

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

    /// Flow along a video. With `warm_start` a pair starts from the flow of the pair before it, moved along itself
    /// ([`forward_interpolate`]).
    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(PairByPair { estimator: self, warm_start, last: None, flow: None })
    }
}

/// A video, estimated as its frames come. What a method computes of a frame alone, it need not compute twice.
pub trait FlowSequence {
    /// The next frames, and the flow to each of them from the one before it. The first frame of the video has none before
    /// it and gives none. A method that can estimates these pairs at once.
    ///
    /// # Errors
    /// As [`FlowEstimator::estimate`]. A sequence that gave an error goes on from wherever it was.
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowField>, EstimateError>;
}

/// For methods that work on two frames.
struct PairByPair<'a, E: ?Sized> {
    estimator: &'a E,
    warm_start: bool,
    last: Option<Image>,
    flow: Option<FlowField>,
}

impl<E: FlowEstimator + ?Sized> FlowSequence for PairByPair<'_, E> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowField>, EstimateError> {
        let mut flows = Vec::with_capacity(frames.len());
        let mut last = self.last.as_ref();
        for frame in frames {
            if let Some(last) = last {
                let flow = match &self.flow {
                    Some(before) => {
                        self.estimator.estimate_from(last, frame, &forward_interpolate(before))?
                    }
                    None => self.estimator.estimate(last, frame)?,
                };
                if self.warm_start {
                    self.flow = Some(flow.clone());
                }
                flows.push(flow);
            }
            last = Some(frame);
        }
        self.last = frames.last().cloned().or(self.last.take());
        Ok(flows)
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
