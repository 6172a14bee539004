//! The faces of clips.
//!
//! Both frames of a clip are cropped identically, by the onset's landmarks: separate landmarks would add their noise to the
//! motion.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use srflow_core::{Size, excerpt};
use srflow_data::micro_expression::{Annotation, Clip};
use srflow_face::{
    AVERAGE_FACE, FaceBox, FaceError, FaceFinder, FacePoints, FrameCrop, LandmarkTable, write_landmarks,
};
use srflow_files::{FileProblem, read_image, whole_number};

use crate::extract_error::{ExtractError, ExtractProblem};

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

/// Landmarks of clips, from a CSV file with one row per clip or per frame.
///
/// Columns: `subject`, `clip`, optionally `dataset` and `frame`, and the points of a [`LandmarkTable`]. If a clip has several rows,
/// that of the onset is used.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmarks {
    path: PathBuf,
    clips: BTreeMap<ClipName, Vec<Row>>,
    note: Option<String>,
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
    /// `None` where the program that wrote the file found no face.
    face: Option<FacePoints>,
}

/// Columns of the file beside the points.
const NEEDED: [&str; 2] = ["subject", "clip"];
const OPTIONAL: [&str; 2] = ["dataset", "frame"];

impl Landmarks {
    /// Reads the file.
    ///
    /// # Errors
    /// When it cannot be read, lacks columns, or holds something other than numbers.
    pub fn read(path: &Path) -> Result<Self, FaceError> {
        let table = LandmarkTable::read(path, &NEEDED, &OPTIONAL)?;
        let mut landmarks = Self { path: path.to_owned(), clips: BTreeMap::new(), note: table.note() };
        for row in table.rows() {
            let [subject, clip, dataset, frame] = row.keys.as_slice() else { continue };
            let frame = match frame.as_str() {
                "" => None,
                text => Some(whole_number(text).ok_or_else(|| {
                    let (column, expected) = ("frame".to_owned(), "a frame number".to_owned());
                    let found = text.to_owned();
                    FileProblem::Cell { row: row.line, column, expected, found }.in_file(path)
                })?),
            };
            let name = ClipName { dataset: dataset.clone(), subject: subject.clone(), clip: clip.clone() };
            landmarks.clips.entry(name).or_default().push(Row { frame, face: row.face.clone() });
        }
        Ok(landmarks)
    }

    /// Finds the face in the onset frame of each clip, and writes the file that [`Landmarks::read`] reads; without `force`, not over other
    /// contents. `index` chooses among several
    /// faces, see [`FaceFinder::face`].
    ///
    /// # Errors
    /// The error of the first clip, in order, whose onset cannot be read or has no face or several; and when the file cannot be
    /// written.
    pub fn find(
        clips: &[&Clip],
        finder: &FaceFinder,
        index: Option<usize>,
        path: &Path,
        force: bool,
        on_clip: &(dyn Fn() + Sync),
    ) -> Result<Self, ExtractError> {
        let find = |clip: &&Clip| -> Result<FacePoints, ExtractProblem> {
            let onset = clip.annotation.onset;
            let file = clip.frame(onset).ok_or(ExtractProblem::NoFrame(onset))?;
            let face = finder.face(&read_image(file)?, index);
            let face =
                face.map_err(|error| ExtractProblem::NoSingleFace { onset: file.to_owned(), error })?;
            on_clip();
            Ok(face.points)
        };
        let of_clip = |clip: &&Clip| find(clip).map_err(|problem| ExtractError { clip: clip.id(), problem });
        let found: Vec<Result<FacePoints, ExtractError>> = clips.par_iter().map(of_clip).collect();
        let found: Vec<FacePoints> = found.into_iter().collect::<Result<_, _>>()?;
        let mut landmarks = Self { path: path.to_owned(), clips: BTreeMap::new(), note: None };
        let mut rows = Vec::new();
        for (clip, face) in clips.iter().zip(&found) {
            let Annotation { subject, clip: name, onset, .. } = &clip.annotation;
            let dataset = clip.dataset.clone();
            rows.push((vec![subject.clone(), name.clone(), dataset.clone(), onset.to_string()], face));
            let key = ClipName { dataset, subject: subject.clone(), clip: name.clone() };
            landmarks
                .clips
                .entry(key)
                .or_default()
                .push(Row { frame: Some(*onset), face: Some(face.clone()) });
        }
        let written = write_landmarks(path, &[NEEDED, OPTIONAL].concat(), force, rows);
        written.map_err(|error| ExtractError { clip: "all clips".to_owned(), problem: error.into() })?;
        Ok(landmarks)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the user should know about how the file was read.
    pub fn note(&self) -> Option<&str> {
        self.note.as_deref()
    }

    /// The face in a clip's onset frame, or in the clip if the file has no frame numbers.
    ///
    /// # Errors
    /// When the file has no row of the clip, or that row has no face.
    pub fn of_clip(&self, dataset: &str, annotation: &Annotation) -> Result<&FacePoints, FaceError> {
        let rows_of = |dataset: &str| {
            let (subject, clip) = (annotation.subject.clone(), annotation.clip.clone());
            self.clips.get(&ClipName { dataset: dataset.to_owned(), subject, clip })
        };
        let rows = rows_of(dataset).or_else(|| rows_of(""));
        let at_onset = rows.and_then(|rows| {
            let of_frame = |frame: Option<u64>| {
                let of_frame = || rows.iter().filter(move |row| row.frame == frame);
                of_frame().find(|row| row.face.is_some()).or_else(|| of_frame().next())
            };
            of_frame(Some(annotation.onset)).or_else(|| of_frame(None))
        });
        at_onset.and_then(|row| row.face.as_ref()).ok_or_else(|| {
            let Annotation { subject, clip, onset, .. } = annotation;
            let why = match (at_onset, rows, self.respelled(annotation)) {
                (Some(_), ..) => " (the tracker found no face in its row)".to_owned(),
                (_, Some(_), _) => format!(" in its onset, frame {onset}"),
                (.., Some(other)) => {
                    format!(" (the file calls the subject {}: write it alike)", excerpt(other))
                }
                _ => String::new(),
            };
            FaceError::NoLandmarks {
                path: self.path.clone(),
                of: format!("clip {clip} of subject {subject}{why}"),
            }
        })
    }

    /// The subject of a row that differs from that of the clip in zeros before or behind it alone.
    fn respelled(&self, annotation: &Annotation) -> Option<&str> {
        let number = whole_number(&annotation.subject)?;
        let same =
            |name: &&ClipName| name.clip == annotation.clip && whole_number(&name.subject) == Some(number);
        self.clips.keys().find(same).map(|name| name.subject.as_str())
    }
}

impl FaceCrop {
    /// The crop for a clip.
    ///
    /// # Errors
    /// When its landmarks are missing.
    pub fn of_clip(&self, dataset: &str, annotation: &Annotation) -> Result<FrameCrop, FaceError> {
        Ok(match self {
            Self::Whole => FrameCrop::Whole,
            Self::Fixed(face) => FrameCrop::Fixed(*face),
            Self::Landmarks(landmarks) => FrameCrop::upright(landmarks.of_clip(dataset, annotation)?),
        })
    }
}

impl FaceCrop {
    /// dlib's points in the onset of a clip, as shares of its crop; those of an average face where no landmarks are known.
    ///
    /// # Errors
    /// When the file of landmarks has none of the clip.
    pub fn points_of_clip(
        &self,
        dataset: &str,
        annotation: &Annotation,
    ) -> Result<[[f64; 2]; 68], FaceError> {
        let Self::Landmarks(landmarks) = self else { return Ok(AVERAGE_FACE) };
        let face = landmarks.of_clip(dataset, annotation)?;
        let crop = FrameCrop::upright(face);
        // An upright crop has a size of its own.
        let side = crop.size_in(Size::default()).width;
        let share = |point: [f64; 2]| crop.point(point).map(|at| (at + 0.5) / side as f64);
        Ok(face.dlib.as_deref().map_or(AVERAGE_FACE, |dlib| dlib.map(share)))
    }

    /// In a word, without files of this machine.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Whole => "whole frames",
            Self::Fixed(_) => "a box of the frames",
            Self::Landmarks(_) => "upright by landmarks",
        }
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
