//! How the regions of a face move along a video.

use srflow_core::{EstimateError, FlowEstimator, Image, Plane, SurfaceMotion};
use srflow_face::FaceError;

use super::regions::{RegionMotion, mean_motion};
use super::view::{FaceView, Sight};
use crate::head_motion::{HeadMotion, face};

/// Seconds until another frame becomes the one that motion is measured from, and for how long both are.
const SEGMENT_SECONDS: f64 = 1.0;
const OVERLAP_SECONDS: f64 = 0.2;

/// The motion of a face along a video, since its first frame. Lengths are in pixels of the face's crop.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Signals {
    /// Of every frame: where the regions are, without the head's motion.
    pub regions: Vec<RegionMotion>,
    /// Of every frame: where the middle of the face is.
    pub head: Vec<[f64; 2]>,
    /// Of every frame: whether its motion can be used. Where no face is seen, the motion stays as it was.
    pub usable: Vec<bool>,
}

impl Signals {
    /// How far the regions move from one frame to another.
    pub fn moved(&self, from: usize, to: usize) -> RegionMotion {
        let [from, to] = [from, to].map(|frame| &self.regions[frame]);
        std::array::from_fn(|region| [0, 1].map(|axis| to[region][axis] - from[region][axis]))
    }
}

/// Why motion could not be measured.
#[derive(Debug, thiserror::Error)]
pub enum SignalError {
    /// The face cannot be cut out.
    #[error(transparent)]
    Face(#[from] FaceError),
    /// The flow method failed.
    #[error(transparent)]
    Flow(#[from] EstimateError),
}

/// Measures [`Signals`] frame by frame. Flow is estimated from a reference frame, which changes every second: so errors do not add up from frame to frame,
/// and the face never moves far. Each reference frame has its own view of the face.
pub struct SignalRecorder<'a> {
    estimator: &'a dyn FlowEstimator,
    head_motion: HeadMotion,
    mask: Option<Plane>,
    segment: usize,
    overlap: usize,
    current: Option<Segment>,
    /// The segment before, while its frames overlap.
    before: Option<Segment>,
    /// Frames of the current segment whose place relative to the video's first frame is not known yet.
    waiting: Vec<Position>,
    /// The same frames as the segment before sees them.
    seen_before: Vec<Position>,
    last: Position,
    signals: Signals,
}

struct Segment {
    view: FaceView,
    reference: Image,
    frames: usize,
    offset: Position,
}

#[derive(Debug, Clone, Copy)]
struct Position {
    regions: RegionMotion,
    head: [f64; 2],
}

impl Position {
    const ZERO: Self = Self { regions: [[0.0; 2]; 16], head: [0.0; 2] };

    /// `factor` times another one more.
    fn plus(mut self, other: &Self, factor: f64) -> Self {
        let add = |sum: &mut f64, value: f64| *sum += factor * value;
        for (sum, value) in self.regions.as_flattened_mut().iter_mut().zip(other.regions.as_flattened()) {
            add(sum, *value);
        }
        self.head.iter_mut().zip(other.head).for_each(|(sum, value)| add(sum, value));
        self
    }
}

impl<'a> SignalRecorder<'a> {
    /// For videos at so many frames per second.
    pub fn new(estimator: &'a dyn FlowEstimator, head_motion: HeadMotion, fps: f64) -> Self {
        let frames = |seconds: f64| ((seconds * fps).round() as usize).max(2);
        Self {
            estimator,
            head_motion,
            mask: None,
            segment: frames(SEGMENT_SECONDS),
            overlap: frames(OVERLAP_SECONDS),
            current: None,
            before: None,
            waiting: Vec::new(),
            seen_before: Vec::new(),
            last: Position::ZERO,
            signals: Signals::default(),
        }
    }

    /// Adds the next frame, as the face is seen in it. Frames before the first view are without a face.
    ///
    /// # Errors
    /// When the flow method fails, or the face is not in the frame.
    pub fn push(&mut self, frame: &Image, sight: Sight) -> Result<(), SignalError> {
        let view = match (sight, &self.current) {
            (Sight::Lost, _) | (Sight::Same, None) => {
                self.settle();
                self.current = None;
                let last = self.last;
                self.take(last, false);
                return Ok(());
            }
            (Sight::Anew(view), _) => Some(*view),
            (Sight::Same, Some(segment)) => (segment.frames >= self.segment).then(|| segment.view.clone()),
        };
        if let Some(view) = view {
            self.begin(view, frame)?;
        }
        let (old, new) = rayon::join(
            || self.before.as_ref().map(|segment| self.position(segment, frame)).transpose(),
            || match &self.current {
                Some(segment) if segment.frames > 0 => self.position(segment, frame),
                _ => Ok(Position::ZERO),
            },
        );
        let (old, new) = (old?, new?);
        let mut offset = Position::ZERO;
        if let Some(segment) = &mut self.current {
            segment.frames += 1;
            offset = segment.offset;
        }
        match (old, &self.before) {
            (Some(old), Some(before)) => {
                self.seen_before.push(old.plus(&before.offset, 1.0));
                self.waiting.push(new);
                if self.waiting.len() == self.overlap {
                    self.settle();
                }
            }
            _ => self.take(new.plus(&offset, 1.0), true),
        }
        Ok(())
    }

    /// Makes a frame the one that motion is measured from.
    fn begin(&mut self, view: FaceView, frame: &Image) -> Result<(), FaceError> {
        self.settle();
        if self.head_motion == HeadMotion::Subtract && self.mask.is_none() {
            self.mask = Some(face(view.size()));
        }
        self.before = self.current.take();
        // Without a segment before, the face is taken to be as it was when it was last seen.
        let segment = Segment { reference: view.cut(frame)?, view, frames: 0, offset: self.last };
        self.current = Some(segment);
        Ok(())
    }

    /// What was measured.
    pub fn finish(mut self) -> Signals {
        self.settle();
        self.signals
    }

    /// Joins the current segment to the one before, so that both have the same mean over the frames that both see.
    fn settle(&mut self) {
        if self.waiting.is_empty() {
            return;
        }
        let share = 1.0 / self.waiting.len() as f64;
        let mut offset = Position::ZERO;
        for (old, new) in self.seen_before.drain(..).zip(&self.waiting) {
            offset = offset.plus(&old, share).plus(new, -share);
        }
        for position in std::mem::take(&mut self.waiting) {
            self.take(position.plus(&offset, 1.0), true);
        }
        if let Some(segment) = &mut self.current {
            segment.offset = offset;
        }
        self.before = None;
    }

    fn take(&mut self, position: Position, seen: bool) {
        self.last = position;
        self.signals.regions.push(position.regions);
        self.signals.head.push(position.head);
        self.signals.usable.push(seen);
    }

    fn position(&self, segment: &Segment, frame: &Image) -> Result<Position, SignalError> {
        let flow = self.estimator.estimate(&segment.reference, &segment.view.cut(frame)?)?;
        let motion = match self.head_motion {
            HeadMotion::Keep => None,
            HeadMotion::Subtract => SurfaceMotion::fit(&flow, self.mask.as_ref()),
        };
        let regions = mean_motion(segment.view.boxes(), flow.size(), |x, y| {
            let of_head = motion.as_ref().map_or([0.0; 2], |motion| motion.at(x, y));
            let moved = flow.get(x, y);
            [0, 1].map(|axis| f64::from(moved[axis] - of_head[axis]))
        });
        let head = motion.map_or([0.0; 2], |motion| motion.translation_px());
        Ok(Position { regions, head })
    }
}
