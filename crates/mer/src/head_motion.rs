//! The motion of the head between two frames, which is taken out of the flow.

use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, Plane, Size, SurfaceMotion, named, serialize_as_text};

use crate::features::FEATURE_SIDE;

/// The ellipse of a face in a crop whose eyes are level and whose sides are about 2.5 times as long as the eyes are apart, as
/// [`srflow_face::FrameCrop::upright`] and published face crops are: middle and half axes, as shares of the sides.
const FACE_MIDDLE: [f32; 2] = [0.5, 0.5];
const FACE_HALF: [f32; 2] = [0.365, 0.5];

/// Whether features have the flow of the head, or that of the expression alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum HeadMotion {
    /// The flow is used as it is.
    Keep,
    /// The motion that most of the flow follows ([`SurfaceMotion`]) is the head's, and is subtracted.
    #[default]
    Subtract,
}

named!(HeadMotion, "a treatment of head motion", { Keep => "keep", Subtract => "subtract" });
serialize_as_text!(HeadMotion);

impl HeadMotion {
    /// The flow for the features, and the motion that was subtracted. The motion is fitted to the flow of the face; a flow without
    /// known pixels there stays unchanged.
    pub fn applied(self, flow: FlowField) -> (FlowField, Option<SubtractedMotion>) {
        let motion = match self {
            Self::Keep => None,
            Self::Subtract => SurfaceMotion::fit(&flow, Some(&face(flow.size()))),
        };
        match motion {
            None => (flow, None),
            Some(motion) => (motion.subtracted_from(&flow), Some(SubtractedMotion::of(&motion, flow.size()))),
        }
    }

    /// Clears what is not the face in a map of flow or strain: hair and background do not move with the head.
    pub fn within_face(self, map: Plane) -> Plane {
        match self {
            Self::Keep => map,
            Self::Subtract => {
                let face = face(map.size());
                Plane::from_fn(map.width(), map.height(), |x, y| {
                    if face.get(x, y) > 0.0 { map.get(x, y) } else { 0.0 }
                })
            }
        }
    }
}

/// Where the face is in a crop of this size: 1 in an ellipse, 0 outside.
pub(crate) fn face(Size { width, height }: Size) -> Plane {
    let along =
        |at: usize, side: usize, middle: f32, half: f32| ((at as f32 + 0.5) / side as f32 - middle) / half;
    Plane::from_fn(width, height, |x, y| {
        let x = along(x, width, FACE_MIDDLE[0], FACE_HALF[0]);
        let y = along(y, height, FACE_MIDDLE[1], FACE_HALF[1]);
        f32::from(x * x + y * y < 1.0)
    })
}

/// The head's motion that was subtracted from a clip's flow.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SubtractedMotion {
    /// Of the middle, right and down, in pixels of the feature map.
    pub translation_px: [f64; 2],
    /// Clockwise as seen.
    pub rotation_degrees: f64,
    /// Growth: 1.01 is larger by 1 %.
    pub scale: f64,
    /// Deviation per component of the flow that follows the motion, in pixels of the feature map.
    pub deviation_px: f64,
}

impl SubtractedMotion {
    /// Of a motion in frames of this size.
    fn of(motion: &SurfaceMotion, Size { width, height }: Size) -> Self {
        let [per_column, per_row] = [width, height].map(|side| FEATURE_SIDE as f64 / side.max(1) as f64);
        let [x, y] = motion.translation_px();
        Self {
            translation_px: [x * per_column, y * per_row],
            rotation_degrees: motion.rotation_degrees(),
            scale: motion.scale(),
            deviation_px: motion.deviation_px() * (per_column + per_row) / 2.0,
        }
    }

    /// Translation, rotation, scale and deviation, as `features.npz` has them.
    pub fn values(&self) -> [f64; 5] {
        let Self { translation_px: [x, y], rotation_degrees, scale, deviation_px } = *self;
        [x, y, rotation_degrees, scale, deviation_px]
    }
}
