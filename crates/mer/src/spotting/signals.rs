//! How the regions of a face move along a video.

use srflow_core::{EstimateError, FlowEstimator, Image, Plane, SurfaceMotion};

use super::regions::RegionBoxes;
use crate::head_motion::{HeadMotion, face};

/// Motion of the 16 regions ([`REGIONS`](super::REGIONS)), in pixels.
pub type RegionMotion = [[f64; 2]; 16];

/// Seconds until another frame becomes the one that motion is measured from, and for how long both are.
const SEGMENT_SECONDS: f64 = 1.0;
const OVERLAP_SECONDS: f64 = 0.2;

/// The motion of a face along a video, since its first frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Signals {
    /// Of every frame: where the regions are, without the head's motion.
    pub regions: Vec<RegionMotion>,
    /// Of every frame: where the middle of the face is.
    pub head: Vec<[f64; 2]>,
}

/// Measures [`Signals`] frame by frame. Flow is estimated from a reference frame, which changes every second: so errors do not add up from frame to frame,
/// and the face never moves far.
pub struct SignalRecorder<'a> {
    estimator: &'a dyn FlowEstimator,
    head_motion: HeadMotion,
    boxes: RegionBoxes,
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
    signals: Signals,
}

struct Segment {
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
    /// For faces with these regions, at so many frames per second.
    pub fn new(
        estimator: &'a dyn FlowEstimator,
        head_motion: HeadMotion,
        boxes: RegionBoxes,
        fps: f64,
    ) -> Self {
        let frames = |seconds: f64| ((seconds * fps).round() as usize).max(2);
        Self {
            estimator,
            head_motion,
            boxes,
            mask: None,
            segment: frames(SEGMENT_SECONDS),
            overlap: frames(OVERLAP_SECONDS),
            current: None,
            before: None,
            waiting: Vec::new(),
            seen_before: Vec::new(),
            signals: Signals::default(),
        }
    }

    /// Adds the next frame, cropped as all others.
    ///
    /// # Errors
    /// When the flow method fails.
    pub fn push(&mut self, frame: Image) -> Result<(), EstimateError> {
        if self.head_motion == HeadMotion::Subtract && self.mask.is_none() {
            self.mask = Some(face(frame.size()));
        }
        if let Some(segment) = self.current.take_if(|segment| segment.frames == self.segment) {
            self.settle();
            self.before = Some(segment);
        }
        let (old, new) = rayon::join(
            || self.before.as_ref().map(|segment| self.position(&segment.reference, &frame)).transpose(),
            || self.current.as_ref().map(|segment| self.position(&segment.reference, &frame)).transpose(),
        );
        let (old, new) = (old?, new?);
        let position = new.unwrap_or(Position::ZERO);
        let segment =
            self.current.get_or_insert(Segment { reference: frame, frames: 0, offset: Position::ZERO });
        segment.frames += 1;
        match (old, &self.before) {
            (Some(old), Some(before)) => {
                self.seen_before.push(old.plus(&before.offset, 1.0));
                self.waiting.push(position);
                if self.waiting.len() == self.overlap {
                    self.settle();
                }
            }
            _ => {
                let offset = segment.offset;
                self.take(position.plus(&offset, 1.0));
            }
        }
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
            self.take(position.plus(&offset, 1.0));
        }
        if let Some(segment) = &mut self.current {
            segment.offset = offset;
        }
        self.before = None;
    }

    fn take(&mut self, Position { regions, head }: Position) {
        self.signals.regions.push(regions);
        self.signals.head.push(head);
    }

    fn position(&self, reference: &Image, frame: &Image) -> Result<Position, EstimateError> {
        let flow = self.estimator.estimate(reference, frame)?;
        let motion = match self.head_motion {
            HeadMotion::Keep => None,
            HeadMotion::Subtract => SurfaceMotion::fit(&flow, self.mask.as_ref()),
        };
        let regions = self.boxes.map(|[[left, right], [top, bottom]]| {
            let (mut sum, mut count) = ([0.0; 2], 0.0);
            for y in top..bottom.min(flow.height()) {
                for x in left..right.min(flow.width()) {
                    let moved = flow.get(x, y);
                    let of_head = motion.as_ref().map_or([0.0; 2], |motion| motion.at(x, y));
                    if moved.iter().all(|component| component.is_finite()) {
                        sum = [0, 1].map(|axis| sum[axis] + f64::from(moved[axis] - of_head[axis]));
                        count += 1.0;
                    }
                }
            }
            sum.map(|sum| if count > 0.0 { sum / count } else { 0.0 })
        });
        let head = motion.map_or([0.0; 2], |motion| motion.translation_px());
        Ok(Position { regions, head })
    }
}
