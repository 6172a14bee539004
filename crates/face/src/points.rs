use srflow_core::{MEDIAPIPE_OF_DLIB, Size};

use crate::crop::{EYES_Y, upright_side};
use crate::{FaceBox, FaceError};

/// Facial points in one frame, pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct FacePoints {
    /// Centres of the eyes: the one on the left in the picture, and the other.
    pub eyes: [[f64; 2]; 2],
    /// dlib's 68 points, if known.
    pub dlib: Option<Box<[[f64; 2]; 68]>>,
}

impl FacePoints {
    /// From two eyes or dlib's 68 points; `None` for any other number, and when the eyes are less than a pixel apart.
    pub fn of(points: &[[f64; 2]]) -> Option<Self> {
        let mean = |points: &[[f64; 2]]| {
            [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / points.len() as f64)
        };
        let dlib: Option<Box<[[f64; 2]; 68]>> = <[[f64; 2]; 68]>::try_from(points).ok().map(Box::new);
        let eyes = match (&dlib, points) {
            (Some(dlib), _) => [mean(&dlib[36..42]), mean(&dlib[42..48])],
            (None, [left, right]) => [*left, *right],
            (None, _) => return None,
        };
        (distance(eyes) >= 1.0).then_some(Self { eyes, dlib })
    }

    /// The box that [`FrameCrop::upright`](crate::FrameCrop::upright) would cut if the face were not tilted, as far as it is inside of a
    /// frame of this size.
    ///
    /// # Errors
    /// When the face is outside of the frame.
    pub fn upright_box(&self, frame: Size) -> Result<FaceBox, FaceError> {
        let middle = self.middle();
        let side = upright_side(self);
        let range = |start: f64, size: usize| {
            let [from, to] = [start, start + side].map(|at| at.round().clamp(0.0, size as f64) as usize);
            (from, to - from)
        };
        let ((left, across), (top, down)) =
            (range(middle[0] - side / 2.0, frame.width), range(middle[1] - EYES_Y * side, frame.height));
        if across == 0 || down == 0 {
            return Err(FaceError::FarOutside { eye: middle, frame });
        }
        Ok(FaceBox { left, top, width: across, height: down })
    }

    /// Pixels from the middle between the eyes to that of another face.
    pub fn distance_to(&self, other: &Self) -> f64 {
        distance([self.middle(), other.middle()])
    }

    /// Midway between the eyes.
    fn middle(&self) -> [f64; 2] {
        let [left, right] = self.eyes;
        [0, 1].map(|axis| (left[axis] + right[axis]) / 2.0)
    }

    /// From the points of MediaPipe's mesh nearest to dlib's. The eyes are midway between their corners, which blinks do not move.
    /// `None` as in [`Self::of`].
    pub(crate) fn of_mesh_table(points: &[[f64; 2]]) -> Option<Self> {
        let mut face = Self::of(points)?;
        let middle = |a: usize, b: usize| [0, 1].map(|axis| (points[a][axis] + points[b][axis]) / 2.0);
        face.eyes = [middle(36, 39), middle(42, 45)];
        (distance(face.eyes) >= 1.0).then_some(face)
    }

    /// From the 468 points of MediaPipe's face mesh: those that are nearest to dlib's.
    pub(crate) fn of_mesh(mesh: &[[f64; 2]]) -> Option<Self> {
        let nearest: Option<Vec<_>> =
            MEDIAPIPE_OF_DLIB.iter().map(|&point| mesh.get(point).copied()).collect();
        Self::of(&nearest?)
    }
}

/// Of two points, in pixels.
pub(crate) fn distance([a, b]: [[f64; 2]; 2]) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}
