use crate::{FlowField, Image, Plane, Size, forward_interpolate};

/// The flow of a pair, with what else a method predicts for it. All have the size of the frames.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowEstimate {
    /// From the first frame to the second. Every pixel is finite.
    pub flow: FlowField,
    /// Expected error of each component of the flow, in pixels.
    pub uncertainty: Option<Plane>,
    /// Probability that a pixel of the first frame is hidden in the second.
    pub occlusion: Option<Plane>,
    /// Refinement iterations of a network that refines its flow; the mean over tiles.
    pub iterations: Option<f32>,
}

impl From<FlowField> for FlowEstimate {
    fn from(flow: FlowField) -> Self {
        Self { flow, uncertainty: None, occlusion: None, iterations: None }
    }
}

/// A method that computes optical flow between two frames, classical or a network.
pub trait FlowEstimator: Send + Sync {
    /// Name in tables and for `--method`, e.g. `farneback`.
    fn name(&self) -> &str;

    /// Flow from `frame1` to `frame2`, of the same size. Every pixel of the result is finite.
    ///
    /// # Errors
    /// When the frames differ in size or the method cannot work at that size.
    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError>;

    /// The flow of each pair; all pairs have one size. Methods that support batches estimate them at once. Uncertainty and occlusion,
    /// which take time, come from a [`sequence`](Self::sequence) alone.
    ///
    /// # Errors
    /// As [`estimate`](Self::estimate), when any of the pairs fails.
    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        pairs.iter().map(|[frame1, frame2]| Ok(self.estimate(frame1, frame2)?.into())).collect()
    }

    /// Like [`estimate_pairs`](Self::estimate_pairs) of one pair, starting from an initial flow of the frames' size.
    ///
    /// # Errors
    /// Those of `estimate`, and when the method cannot start from a flow.
    fn estimate_from(
        &self,
        _frame1: &Image,
        _frame2: &Image,
        _initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        Err(EstimateError::Unsupported {
            method: self.name().to_owned(),
            reason: "cannot start from an initial flow; leave it out".to_owned(),
        })
    }

    /// Whether the flow of a pair in a [`sequence`](Self::sequence) depends on the previous pairs even without a warm start.
    fn remembers(&self) -> bool {
        false
    }

    /// Flow along a video. With `warm_start` a pair starts from the flow of the previous one, projected forward
    /// ([`forward_interpolate`]).
    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(PairByPair { estimator: self, warm_start, last: None, flow: None })
    }
}

/// A video, estimated frame by frame. Methods can reuse what they computed from a single frame.
pub trait FlowSequence {
    /// Adds the next frames, and returns the flow to each of them from the previous one. The first frame of the video has no
    /// previous one and returns none. Methods that support batches estimate the pairs at once.
    ///
    /// # Errors
    /// As [`FlowEstimator::estimate`]. After an error the sequence can be continued.
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError>;

    /// The flow of the next pair, whose first frame need not be the last frame of the pair before: it may be another window
    /// of it.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    fn push_pair(&mut self, pair: [&Image; 2]) -> Result<FlowEstimate, EstimateError>;
}

/// For methods that work on two frames.
struct PairByPair<'a, E: ?Sized> {
    estimator: &'a E,
    warm_start: bool,
    last: Option<Image>,
    flow: Option<FlowField>,
}

impl<E: FlowEstimator + ?Sized> FlowSequence for PairByPair<'_, E> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let mut flows = Vec::with_capacity(frames.len());
        let before = self.last.take();
        let mut last = before.as_ref();
        for frame in frames {
            if let Some(last) = last {
                flows.push(self.next([last, frame])?);
            }
            last = Some(frame);
        }
        self.last = frames.last().cloned().or(before);
        Ok(flows)
    }

    fn push_pair(&mut self, pair: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        let estimate = self.next(pair)?;
        self.last = Some(pair[1].clone());
        Ok(estimate)
    }
}

impl<E: FlowEstimator + ?Sized> PairByPair<'_, E> {
    fn next(&mut self, [first, second]: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        let estimate = match &self.flow {
            Some(before) => self.estimator.estimate_from(first, second, &forward_interpolate(before))?,
            None => self.estimator.estimate_pairs(&[[first, second]])?.remove(0),
        };
        if self.warm_start {
            self.flow = Some(estimate.flow.clone());
        }
        Ok(estimate)
    }
}

/// Checks that frames, or an initial flow, have the size of the first frame.
///
/// # Errors
/// [`EstimateError::SizeMismatch`] with the first of `others` that differs.
pub fn check_frame_sizes(first: Size, others: impl IntoIterator<Item = Size>) -> Result<(), EstimateError> {
    match others.into_iter().find(|size| *size != first) {
        Some(second) => Err(EstimateError::SizeMismatch { first, second }),
        None => Ok(()),
    }
}

/// Why a [`FlowEstimator`] failed.
#[derive(Debug, thiserror::Error)]
pub enum EstimateError {
    /// The two frames differ in size.
    #[error("the frames differ in size: the first is {first}, the second {second} (WIDTHxHEIGHT)")]
    SizeMismatch { first: Size, second: Size },
    /// The method cannot handle these frames or parameters.
    #[error("{method}: {reason}")]
    Unsupported {
        method: String,
        /// What is wrong, and what to do.
        reason: String,
    },
}
