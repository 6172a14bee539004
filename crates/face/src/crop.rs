//! Crops of frames that hold a face.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;
use srflow_core::{Image, Size};

use crate::FaceError;
use crate::points::{FacePoints, distance};

/// A rectangle in pixels, written `LEFT,TOP,WIDTHxHEIGHT`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaceBox {
    /// Column of its first pixel.
    pub left: usize,
    /// Row of its first pixel.
    pub top: usize,
    /// Width, at least 1.
    pub width: usize,
    /// Height, at least 1.
    pub height: usize,
}

impl FromStr for FaceBox {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (left, rest) = text.split_once(',')?;
            let (top, size) = rest.split_once(',')?;
            let (width, height) = size.split_once(['x', 'X'])?;
            let number = |text: &str| text.trim().parse::<usize>().ok();
            let (width, height) = (number(width)?, number(height)?);
            (width > 0 && height > 0).then_some(Self {
                left: number(left)?,
                top: number(top)?,
                width,
                height,
            })
        };
        parse().ok_or_else(|| {
            format!("`{text}` is not a box; expected LEFT,TOP,WIDTHxHEIGHT, e.g. 180,40,280x340")
        })
    }
}

impl FaceBox {
    /// # Errors
    /// When it is not inside of a frame of this size.
    pub fn check_inside(self, frame: Size) -> Result<(), FaceError> {
        let fits =
            |start: usize, len: usize, whole: usize| start.checked_add(len).is_some_and(|end| end <= whole);
        if fits(self.left, self.width, frame.width) && fits(self.top, self.height, frame.height) {
            return Ok(());
        }
        Err(FaceError::Outside { face: self, frame })
    }
}

impl fmt::Display for FaceBox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{}x{}", self.left, self.top, self.width, self.height)
    }
}

srflow_core::serialize_as_text!(FaceBox);

/// A crop, the same for all frames of a clip: separate ones would add the noise of landmarks to the motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub enum FrameCrop {
    /// Not at all.
    Whole,
    /// To a rectangle.
    Fixed(FaceBox),
    /// To a square of `side` pixels, rotated so that the eyes are level: its pixel `(x, y)` is at `origin + x * right + y * down`
    /// in the frame.
    Upright {
        /// Side of the square in pixels.
        side: usize,
        /// Position of its first pixel.
        origin: [f64; 2],
        /// One pixel to the right, of length 1.
        right: [f64; 2],
    },
}

/// Positions of the eyes in the square, relative to its side, and the maximum side, since the eye distance is untrusted.
const EYES_X: [f64; 2] = [0.3, 0.7];
pub(crate) const EYES_Y: f64 = 0.36;
const MAX_SIDE: f64 = 8192.0;

/// Of the square about a face, in whole pixels.
pub(crate) fn upright_side(face: &FacePoints) -> f64 {
    (distance(face.eyes) / (EYES_X[1] - EYES_X[0])).clamp(1.0, MAX_SIDE).round()
}

impl FrameCrop {
    /// Where the middle between the eyes is in an upright square, as shares of its side.
    pub const EYES_MIDDLE: [f64; 2] = [(EYES_X[0] + EYES_X[1]) / 2.0, EYES_Y];

    /// The square about a face. One pixel of it is one pixel of the frame: nothing is resized here.
    pub fn upright(face: &FacePoints) -> Self {
        let [left, right] = face.eyes;
        let apart = distance([left, right]);
        let direction = [(right[0] - left[0]) / apart, (right[1] - left[1]) / apart];
        let side = upright_side(face);
        let (x, y) = (EYES_X[0] * side, EYES_Y * side);
        // From the left eye back to the square's corner.
        let origin =
            [left[0] - x * direction[0] + y * direction[1], left[1] - x * direction[1] - y * direction[0]];
        Self::Upright { side: side as usize, origin, right: direction }
    }

    /// Crops a frame. Outside the frame its border is repeated.
    ///
    /// # Errors
    /// When a fixed box is not inside the frame, or an eye is far outside.
    pub fn apply(&self, frame: &Image) -> Result<Image, FaceError> {
        match *self {
            Self::Whole => Ok(frame.clone()),
            Self::Fixed(face) => {
                face.check_inside(frame.size())?;
                Ok(frame.crop(face.left, face.top, face.width, face.height))
            }
            Self::Upright { side, origin, right: [c, s] } => {
                let place = |x: f64, y: f64| [origin[0] + x * c - y * s, origin[1] + x * s + y * c];
                let size = frame.size();
                for x in EYES_X {
                    let eye = place(x * side as f64, EYES_Y * side as f64);
                    let near = |at: f64, whole: usize| (at / whole as f64 - 0.5).abs() <= 1.0;
                    if !near(eye[0], size.width) || !near(eye[1], size.height) {
                        return Err(FaceError::FarOutside { eye, frame: size });
                    }
                }
                Ok(Image::from_fn(side, side, |x, y| {
                    let [x, y] = place(x as f64, y as f64);
                    bilinear(frame, x, y)
                }))
            }
        }
    }

    /// Size of the picture that it cuts out of a frame of this size.
    pub fn size_in(&self, frame: Size) -> Size {
        match *self {
            Self::Whole => frame,
            Self::Fixed(FaceBox { width, height, .. }) => Size { width, height },
            Self::Upright { side, .. } => Size::new(side, side),
        }
    }

    /// Position of a point of the frame in the cropped picture.
    pub fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        match *self {
            Self::Whole => [x, y],
            Self::Fixed(face) => [x - face.left as f64, y - face.top as f64],
            Self::Upright { origin, right: [c, s], .. } => {
                let (x, y) = (x - origin[0], y - origin[1]);
                [x * c + y * s, y * c - x * s]
            }
        }
    }
}

fn bilinear(image: &Image, x: f64, y: f64) -> [u8; 3] {
    if image.width() == 0 || image.height() == 0 {
        return [0; 3];
    }
    let (x, y) = (x.clamp(0.0, (image.width() - 1) as f64), y.clamp(0.0, (image.height() - 1) as f64));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(image.width() - 1), (y0 + 1).min(image.height() - 1));
    let (wx, wy) = (x - x0 as f64, y - y0 as f64);
    let (a, b, c, d) = (image.get(x0, y0), image.get(x1, y0), image.get(x0, y1), image.get(x1, y1));
    std::array::from_fn(|i| {
        let mix =
            |near: u8, far: u8, weight: f64| f64::from(near) + (f64::from(far) - f64::from(near)) * weight;
        let (top, bottom) = (mix(a[i], b[i], wx), mix(c[i], d[i], wx));
        (top + (bottom - top) * wy + 0.5) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_face_comes_out_upright() {
        // Two bright eyes on a line that falls by 20 degrees to the right, 40 px apart.
        let (c, s) = (libm::cos(0.35), libm::sin(0.35));
        let eyes = [[60.0, 50.0], [60.0 + 40.0 * c, 50.0 + 40.0 * s]];
        let bright = |x: usize, y: usize, [ex, ey]: [f64; 2]| libm::hypot(x as f64 - ex, y as f64 - ey) < 3.0;
        let frame = Image::from_fn(160, 140, |x, y| {
            [if eyes.iter().any(|eye| bright(x, y, *eye)) { 255 } else { 20 }; 3]
        });
        let crop = FrameCrop::upright(&FacePoints::of(&eyes).unwrap());
        let face = crop.apply(&frame).unwrap();
        assert_eq!(face.size(), Size::new(100, 100));
        for (eye, x) in eyes.into_iter().zip([30.0, 70.0]) {
            let at = crop.point(eye);
            assert!((at[0] - x).abs() < 1e-9 && (at[1] - 36.0).abs() < 1e-9, "{at:?}");
            assert!(face.get(at[0] as usize, at[1] as usize)[0] > 200);
        }
        assert!(face.get(50, 36)[0] < 30);
    }

    #[test]
    fn landmarks_far_outside_of_the_frame_are_refused() {
        let frame = Image::from_fn(160, 140, |_, _| [20; 3]);
        let cut = |eyes: [[f64; 2]; 2]| FrameCrop::upright(&FacePoints::of(&eyes).unwrap()).apply(&frame);
        let at_border = cut([[-10.0, 50.0], [50.0, 50.0]]).unwrap();
        assert_eq!(at_border.size(), Size::new(150, 150), "cut by the border");
        for eyes in
            [[[60.0, 50.0], [9999.0, 50.0]], [[60.0, 50.0], [100.0, 400.0]], [[-900.0, 1.0], [-850.0, 1.0]]]
        {
            let error = cut(eyes).unwrap_err().to_string();
            assert!(error.contains("far outside of the frame of 160x140"), "{error}");
        }
    }

    #[test]
    fn a_box_is_cut_or_refused() {
        let frame = Image::from_fn(30, 20, |x, y| [x as u8, y as u8, 0]);
        let fixed = |text: &str| FrameCrop::Fixed(text.parse().unwrap()).apply(&frame);
        let face = fixed("5,6,10x8").unwrap();
        assert_eq!((face.size(), face.get(0, 0)), (Size::new(10, 8), [5, 6, 0]));
        assert!(fixed("25,0,6x5").unwrap_err().to_string().contains("30x20"));
        assert!(fixed("0,18446744073709551615,6x5").is_err());
        for text in ["", "1,2", "1,2,3", "1,2,0x4", "-1,2,3x4"] {
            assert!(text.parse::<FaceBox>().is_err(), "{text}");
        }
    }
}
