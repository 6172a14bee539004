//! Cropping the face out of a frame and aligning it.
//!
//! Both frames of a clip are cropped identically, by the onset's landmarks: separate landmarks would add their noise to the
//! motion.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use srflow_field::{FileError, FileKind, Image, excerpt, open_file};
use srflow_read::micro_expression::Annotation;

/// How the frames of clips are cropped before flow is computed.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum FaceCrop {
    /// Not at all: released face crops.
    #[default]
    Whole,
    /// The same rectangle of every frame.
    Fixed(FaceBox),
    /// Aligned upright, with the eyes at fixed positions, by given landmarks.
    Landmarks(Landmarks),
}

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

impl fmt::Display for FaceBox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{}x{}", self.left, self.top, self.width, self.height)
    }
}

/// Landmarks of clips, from a CSV file with one row per clip or per frame.
///
/// Columns: `subject`, `clip`, optionally `dataset` and `frame`, and either the 68 points of dlib as `x_0 y_0 .. x_67 y_67`
/// (as OpenFace writes them) or the eyes alone as `left_eye_x left_eye_y right_eye_x right_eye_y`, left and right as the
/// picture shows them. If a clip has several rows, that of the onset is used.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmarks {
    path: PathBuf,
    clips: BTreeMap<ClipName, Vec<Row>>,
}

#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct ClipName {
    /// Empty if the file has no such column.
    dataset: String,
    subject: String,
    clip: String,
}

#[derive(Debug, Clone, PartialEq)]
struct Row {
    /// `None` if the file has no such column.
    frame: Option<u64>,
    face: FacePoints,
}

/// Facial points in one frame, pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct FacePoints {
    /// Centres of the eyes: the one on the left in the picture, and the other.
    pub eyes: [[f64; 2]; 2],
    /// dlib's 68 points, if known.
    pub dlib: Option<Box<[[f64; 2]; 68]>>,
}

/// Why a face could not be cropped.
#[derive(Debug, thiserror::Error)]
pub enum FaceError {
    /// The file could not be opened.
    #[error(transparent)]
    File(#[from] FileError),
    /// The landmarks cannot be read.
    #[error("{}: {reason}", .path.display())]
    Landmarks {
        path: PathBuf,
        /// What was expected, and what was found.
        reason: String,
    },
    /// A clip has no landmarks.
    #[error("{}: no landmarks of clip {clip} of subject {subject}; add a row for it", .path.display())]
    NoLandmarks { path: PathBuf, subject: String, clip: String },
    /// An eye is far outside the frame: the landmarks are those of another frame, or wrong.
    #[error(
        "the landmarks put an eye at ({:.0}, {:.0}), far outside of the frame of {width}x{height} (WIDTHxHEIGHT); mend \
         their row or leave it out", .eye[0], .eye[1]
    )]
    FarOutside {
        /// The eye in pixels.
        eye: [f64; 2],
        /// Width of the frame.
        width: usize,
        /// Height of the frame.
        height: usize,
    },
    /// The box is not inside the frame.
    #[error("the box {face} does not lie in a frame of {width}x{height} (WIDTHxHEIGHT)")]
    Outside {
        face: FaceBox,
        /// Width of the frame.
        width: usize,
        /// Height of the frame.
        height: usize,
    },
}

impl Landmarks {
    /// Reads the file.
    ///
    /// # Errors
    /// When it cannot be read, lacks columns, or holds something other than numbers.
    pub fn read(path: &Path) -> Result<Self, FaceError> {
        let wrong = |reason: String| FaceError::Landmarks { path: path.to_owned(), reason };
        let mut reader =
            csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(open_file(path, FileKind::Table)?.0);
        let headers = reader.headers().map_err(|error| wrong(error.to_string()))?.clone();
        let column = |name: &str| headers.iter().position(|header| header.eq_ignore_ascii_case(name));
        let needed = |name: &str| {
            column(name).ok_or_else(|| {
                wrong(format!(
                    "expected the columns subject, clip and x_0, y_0 to x_67, y_67 (or left_eye_x, left_eye_y, \
                     right_eye_x, right_eye_y), found no {name}"
                ))
            })
        };
        let (subject, clip) = (needed("subject")?, needed("clip")?);
        let (dataset, frame) = (column("dataset"), column("frame"));
        let dlib = column("x_0").is_some();
        let point = |x: &str, y: &str| Ok::<_, FaceError>([needed(x)?, needed(y)?]);
        let points = if dlib {
            (0..68).map(|n| point(&format!("x_{n}"), &format!("y_{n}"))).collect::<Result<Vec<_>, _>>()?
        } else {
            vec![point("left_eye_x", "left_eye_y")?, point("right_eye_x", "right_eye_y")?]
        };

        let mut clips: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for (row, record) in (2..).zip(reader.records()) {
            let record = record.map_err(|error| wrong(error.to_string()))?;
            let coordinate = |at: usize| match record[at].parse::<f64>() {
                Ok(value) if value.abs() <= MAX_COORDINATE => Ok(value),
                _ => Err(wrong(format!(
                    "row {row}, {}: expected a place in a frame, in pixels, found `{}`",
                    excerpt(&headers[at]),
                    excerpt(&record[at])
                ))),
            };
            let read = |[x, y]: &[usize; 2]| Ok([coordinate(*x)?, coordinate(*y)?]);
            let read: Vec<[f64; 2]> = points.iter().map(read).collect::<Result<_, FaceError>>()?;
            let face = FacePoints::of(&read).ok_or_else(|| {
                wrong(format!("row {row}: the eyes are in the same place; leave the row out"))
            })?;
            let number = match frame.map(|at| &record[at]) {
                None | Some("") => None,
                Some(text) => Some(text.parse::<u64>().map_err(|_| {
                    wrong(format!("row {row}, frame: expected a frame number, found `{}`", excerpt(text)))
                })?),
            };
            let key = ClipName {
                dataset: dataset.map_or("", |at| &record[at]).to_owned(),
                subject: record[subject].to_owned(),
                clip: record[clip].to_owned(),
            };
            clips.entry(key).or_default().push(Row { frame: number, face });
        }
        Ok(Self { path: path.to_owned(), clips })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The face in a clip's onset frame, or in the clip if the file has no frame numbers.
    ///
    /// # Errors
    /// When the file has no row of the clip.
    pub fn of_clip(&self, dataset: &str, annotation: &Annotation) -> Result<&FacePoints, FaceError> {
        let rows_of = |dataset: &str| {
            let (subject, clip) = (annotation.subject.clone(), annotation.clip.clone());
            self.clips.get(&ClipName { dataset: dataset.to_owned(), subject, clip })
        };
        let at_onset = rows_of(dataset).or_else(|| rows_of("")).and_then(|rows| {
            let onset = rows.iter().find(|row| row.frame == Some(annotation.onset));
            onset.or_else(|| rows.iter().find(|row| row.frame.is_none()))
        });
        at_onset.map(|row| &row.face).ok_or_else(|| FaceError::NoLandmarks {
            path: self.path.clone(),
            subject: annotation.subject.clone(),
            clip: annotation.clip.clone(),
        })
    }
}

impl FacePoints {
    /// From two eyes or dlib's 68 points; `None` when the eyes coincide.
    fn of(points: &[[f64; 2]]) -> Option<Self> {
        let mean = |points: &[[f64; 2]]| {
            [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / points.len() as f64)
        };
        let dlib: Option<Box<[[f64; 2]; 68]>> = <[[f64; 2]; 68]>::try_from(points).ok().map(Box::new);
        let eyes = match &dlib {
            Some(dlib) => [mean(&dlib[36..42]), mean(&dlib[42..48])],
            None => [*points.first()?, *points.get(1)?],
        };
        (distance(eyes) >= 1.0).then_some(Self { eyes, dlib })
    }
}

fn distance([a, b]: [[f64; 2]; 2]) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}

/// The crop of one clip's frames, the same for all of them.
#[derive(Debug, Clone, PartialEq)]
pub enum ClipCrop {
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
const EYES_Y: f64 = 0.36;
const MAX_SIDE: f64 = 8192.0;

/// Larger coordinates, in pixels, are not in any frame of a face.
const MAX_COORDINATE: f64 = 65_536.0;

impl FaceCrop {
    /// The crop for a clip.
    ///
    /// # Errors
    /// When its landmarks are missing.
    pub fn of_clip(&self, dataset: &str, annotation: &Annotation) -> Result<ClipCrop, FaceError> {
        Ok(match self {
            Self::Whole => ClipCrop::Whole,
            Self::Fixed(face) => ClipCrop::Fixed(*face),
            Self::Landmarks(landmarks) => ClipCrop::upright(landmarks.of_clip(dataset, annotation)?),
        })
    }
}

impl fmt::Display for FaceCrop {
    /// Description for results: `whole frames`, `box 10,20,300x300`, `upright by FILE`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole => f.write_str("whole frames"),
            Self::Fixed(face) => write!(f, "box {face}"),
            Self::Landmarks(landmarks) => {
                write!(f, "upright by the landmarks of {}", landmarks.path.display())
            }
        }
    }
}

impl ClipCrop {
    /// The square about a face. One pixel of it is one pixel of the frame: nothing is resized here.
    fn upright(face: &FacePoints) -> Self {
        let [left, right] = face.eyes;
        let apart = distance([left, right]);
        let direction = [(right[0] - left[0]) / apart, (right[1] - left[1]) / apart];
        let side = (apart / (EYES_X[1] - EYES_X[0])).clamp(1.0, MAX_SIDE).round();
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
                let (width, height) = frame.size();
                let fits = |start: usize, len: usize, whole: usize| {
                    start.checked_add(len).is_some_and(|end| end <= whole)
                };
                if !fits(face.left, face.width, width) || !fits(face.top, face.height, height) {
                    return Err(FaceError::Outside { face, width, height });
                }
                Ok(frame.crop(face.left, face.top, face.width, face.height))
            }
            Self::Upright { side, origin, right: [c, s] } => {
                let place = |x: f64, y: f64| [origin[0] + x * c - y * s, origin[1] + x * s + y * c];
                let (width, height) = frame.size();
                for x in EYES_X {
                    let eye = place(x * side as f64, EYES_Y * side as f64);
                    let near = |at: f64, whole: usize| (at / whole as f64 - 0.5).abs() <= 1.0;
                    if !near(eye[0], width) || !near(eye[1], height) {
                        return Err(FaceError::FarOutside { eye, width, height });
                    }
                }
                Ok(Image::from_fn(side, side, |x, y| {
                    let [x, y] = place(x as f64, y as f64);
                    bilinear(frame, x, y)
                }))
            }
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

    fn annotation(subject: &str, clip: &str, onset: u64) -> Annotation {
        Annotation {
            subject: subject.to_owned(),
            clip: clip.to_owned(),
            class: 1,
            label: String::new(),
            action_units: String::new(),
            onset,
            apex: None,
            offset: onset + 9,
        }
    }

    fn landmarks(text: &str) -> Result<Landmarks, FaceError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("landmarks.csv");
        std::fs::write(&path, text).unwrap();
        Landmarks::read(&path)
    }

    #[test]
    fn a_tilted_face_comes_out_upright() {
        // Two bright eyes on a line that falls by 20 degrees to the right, 40 px apart.
        let (c, s) = (libm::cos(0.35), libm::sin(0.35));
        let eyes = [[60.0, 50.0], [60.0 + 40.0 * c, 50.0 + 40.0 * s]];
        let bright = |x: usize, y: usize, [ex, ey]: [f64; 2]| libm::hypot(x as f64 - ex, y as f64 - ey) < 3.0;
        let frame = Image::from_fn(160, 140, |x, y| {
            [if eyes.iter().any(|eye| bright(x, y, *eye)) { 255 } else { 20 }; 3]
        });
        let crop = ClipCrop::upright(&FacePoints::of(&eyes).unwrap());
        let face = crop.apply(&frame).unwrap();
        assert_eq!(face.size(), (100, 100));
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
        let cut = |eyes: [[f64; 2]; 2]| ClipCrop::upright(&FacePoints::of(&eyes).unwrap()).apply(&frame);
        assert_eq!(cut([[-10.0, 50.0], [50.0, 50.0]]).unwrap().size(), (150, 150), "cut by the border");
        for eyes in
            [[[60.0, 50.0], [9999.0, 50.0]], [[60.0, 50.0], [100.0, 400.0]], [[-900.0, 1.0], [-850.0, 1.0]]]
        {
            let error = cut(eyes).unwrap_err().to_string();
            assert!(error.contains("far outside of the frame of 160x140"), "{error}");
        }
        let text = "subject,clip,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n1,a,2,2,99999,2\n";
        let error = landmarks(text).unwrap_err().to_string();
        assert!(error.contains("row 2, right_eye_x: expected a place in a frame"), "{error}");
    }

    #[test]
    fn a_box_is_cut_or_refused() {
        let frame = Image::from_fn(30, 20, |x, y| [x as u8, y as u8, 0]);
        let fixed = |text: &str| ClipCrop::Fixed(text.parse().unwrap()).apply(&frame);
        let face = fixed("5,6,10x8").unwrap();
        assert_eq!((face.size(), face.get(0, 0)), ((10, 8), [5, 6, 0]));
        assert!(fixed("25,0,6x5").unwrap_err().to_string().contains("30x20"));
        assert!(fixed("0,18446744073709551615,6x5").is_err());
        for text in ["", "1,2", "1,2,3", "1,2,0x4", "-1,2,3x4"] {
            assert!(text.parse::<FaceBox>().is_err(), "{text}");
        }
    }

    #[test]
    fn the_row_of_the_onset_counts() {
        let text = "dataset,subject,clip,frame,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n\
                    samm,006,a,5,10,10,50,10\nsamm,006,a,7,12,10,52,10\n,007,a,,1,2,31,2\n";
        let landmarks = landmarks(text).unwrap();
        let eye = |dataset, subject, onset| {
            landmarks.of_clip(dataset, &annotation(subject, "a", onset)).map(|f| f.eyes[0])
        };
        assert_eq!(eye("samm", "006", 7).unwrap(), [12.0, 10.0]);
        assert_eq!(eye("anything", "007", 3).unwrap(), [1.0, 2.0]);
        let error = eye("samm", "006", 6).unwrap_err().to_string();
        assert!(error.contains("subject 006") && error.contains("landmarks.csv"), "{error}");
    }

    #[test]
    fn dlibs_points_give_the_eyes() {
        let names: Vec<String> = (0..68).flat_map(|n| [format!("x_{n}"), format!("y_{n}")]).collect();
        let values: Vec<String> = (0..68).flat_map(|n| [(2 * n).to_string(), n.to_string()]).collect();
        let landmarks =
            landmarks(&format!("subject,clip,{}\n1,a,{}\n", names.join(","), values.join(","))).unwrap();
        let face = landmarks.of_clip("d", &annotation("1", "a", 0)).unwrap();
        assert_eq!(face.eyes, [[77.0, 38.5], [89.0, 44.5]]);
        assert_eq!(face.dlib.as_ref().unwrap()[67], [134.0, 67.0]);
    }

    #[test]
    fn wrong_landmarks_are_refused() {
        for (text, expected) in [
            ("subject,clip,x_0,y_0\n", "x_1"),
            ("subject,left_eye_x\n", "no clip"),
            (
                "subject,clip,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n1,a,x,2,3,4\n",
                "row 2, left_eye_x",
            ),
            ("subject,clip,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n1,a,2,2,2,2\n", "same place"),
            (
                "subject,clip,frame,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n1,a,z,2,2,9,2\n",
                "frame number",
            ),
        ] {
            let error = landmarks(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
