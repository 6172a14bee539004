//! How a face is seen in the frames of a video, and when it has moved too far for that.

use srflow_core::resize::resize_image_antialiased;
use srflow_core::{Image, Size};
use srflow_face::{FaceError, FacePoints, FrameCrop};

use super::regions::{RegionBoxes, regions};

/// Larger faces are shrunk to this side, in pixels.
const LARGEST_SIDE: usize = 256;

/// A face that has moved less stays in its crop: as a share of the crop's side, in radians, and in size.
const STAYS: f64 = 0.03;
const STAYS_UPRIGHT: f64 = 0.05;
const STAYS_LARGE: f64 = 0.05;

/// The crop that shows a face, and where the regions are in it.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceView {
    crop: FrameCrop,
    size: Size,
    boxes: RegionBoxes,
    pixel: f64,
}

impl FaceView {
    /// A face in a frame: its landmarks if they are known, and the crop about it.
    ///
    /// # Errors
    /// When the crop is not in the frame.
    pub fn new(points: Option<&FacePoints>, crop: FrameCrop, frame: &Image) -> Result<Self, FaceError> {
        let cropped = crop.apply(frame)?.size();
        let shrunk = (cropped.width.max(cropped.height) as f64 / LARGEST_SIDE as f64).max(1.0);
        let small = |length: usize| ((length as f64 / shrunk).round() as usize).max(1);
        Ok(Self::of_size(points, crop, cropped, Size::new(small(cropped.width), small(cropped.height))))
    }

    fn of_size(points: Option<&FacePoints>, crop: FrameCrop, cropped: Size, size: Size) -> Self {
        let pixel = cropped.width as f64 / size.width as f64;
        let boxes = regions(points, &crop, cropped).map(|ranges| {
            ranges.map(|[first, end]| {
                let first = (first as f64 / pixel) as usize;
                [first, ((end as f64 / pixel).round() as usize).max(first + 1)]
            })
        });
        Self { crop, size, boxes, pixel }
    }

    /// The same face elsewhere, cut out to the same size.
    fn elsewhere(&self, points: &FacePoints) -> Self {
        let crop = FrameCrop::upright(points);
        let cropped = crop.size_in(self.size);
        Self::of_size(Some(points), crop, cropped, self.size)
    }

    /// Cuts the face out of a frame.
    ///
    /// # Errors
    /// When the crop is not in the frame.
    pub fn cut(&self, frame: &Image) -> Result<Image, FaceError> {
        let face = self.crop.apply(frame)?;
        Ok(if face.size() == self.size { face } else { resize_image_antialiased(&face, self.size) })
    }

    /// Of the pictures that are cut out.
    pub fn size(&self) -> Size {
        self.size
    }

    /// The part of the frame that is cut out.
    pub fn crop(&self) -> &FrameCrop {
        &self.crop
    }

    /// The regions in the pictures that are cut out.
    pub fn boxes(&self) -> &RegionBoxes {
        &self.boxes
    }

    /// Pixels of the video per pixel of the pictures that are cut out.
    pub fn pixel(&self) -> f64 {
        self.pixel
    }
}

/// Whether a face has left its place in an upright crop.
fn has_left(crop: &FrameCrop, points: &FacePoints) -> bool {
    let (
        FrameCrop::Upright { side, right, .. },
        FrameCrop::Upright { side: other_side, right: other_right, .. },
    ) = (crop, &FrameCrop::upright(points))
    else {
        return false;
    };
    let side = *side as f64;
    let [left_eye, right_eye] = points.eyes.map(|eye| crop.point(eye));
    let middle = [0, 1].map(|axis| (left_eye[axis] + right_eye[axis]) / (2.0 * side));
    let [x, y] = FrameCrop::EYES_MIDDLE;
    let turned = right[0] * other_right[1] - right[1] * other_right[0];
    libm::hypot(middle[0] - x, middle[1] - y) > STAYS
        || turned.abs() > STAYS_UPRIGHT
        || (*other_side as f64 / side - 1.0).abs() > STAYS_LARGE
}

/// How the face is seen in the next frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Sight {
    /// As in the frame before.
    Same,
    /// Otherwise, from this frame on.
    Anew(Box<FaceView>),
    /// Not at all.
    Lost,
}

/// Seconds between frames in which the face is looked for.
const LOOK_SECONDS: f64 = 0.2;
/// A face that is not found so many times is lost; detectors miss one now and then.
const MISSES: u32 = 2;

/// Follows a face along a video.
#[derive(Debug)]
pub struct FaceFollower {
    every: usize,
    misses: u32,
    view: Option<FaceView>,
    lost: bool,
    /// Where the face was in the look before.
    before: Option<FrameCrop>,
    /// Of every frame: whether the head does not move so fast that it leaves its place between two looks.
    steady: Vec<bool>,
}

impl FaceFollower {
    /// Along a video with so many frames per second.
    pub fn new(fps: f64) -> Self {
        let every = ((LOOK_SECONDS * fps).round() as usize).max(1);
        Self { every, misses: 0, view: None, lost: true, before: None, steady: Vec::new() }
    }

    /// How the face is seen in the next frame. `find` looks for its landmarks there, and is asked five times a second; frames without a
    /// face are `None`.
    ///
    /// # Errors
    /// Those of `find`, and when the landmarks are not in the frame.
    pub fn follow<E: From<FaceError>>(
        &mut self,
        frame: &Image,
        find: impl FnOnce() -> Result<Option<FacePoints>, E>,
    ) -> Result<Sight, E> {
        let looks = self.steady.len().is_multiple_of(self.every);
        self.steady.push(true);
        if !looks {
            return Ok(self.unchanged());
        }
        let Some(points) = find()? else {
            self.misses += 1;
            self.lost |= self.misses >= MISSES;
            return Ok(self.unchanged());
        };
        self.misses = 0;
        if self.before.replace(FrameCrop::upright(&points)).is_some_and(|before| has_left(&before, &points)) {
            let between = self.steady.len().saturating_sub(self.every + 1);
            self.steady[between..].fill(false);
        }
        let view = match &self.view {
            Some(view) if !self.lost && !has_left(&view.crop, &points) => return Ok(Sight::Same),
            Some(view) => view.elsewhere(&points),
            None => FaceView::new(Some(&points), FrameCrop::upright(&points), frame)?,
        };
        self.lost = false;
        Ok(Sight::Anew(Box::new(self.view.insert(view).clone())))
    }

    fn unchanged(&self) -> Sight {
        if self.lost { Sight::Lost } else { Sight::Same }
    }

    /// Of every frame: whether the head is steady, and does not leave its place within a fifth of a second.
    pub fn steady(&self) -> &[bool] {
        &self.steady
    }
}
