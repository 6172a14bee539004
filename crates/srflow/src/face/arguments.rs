//! Arguments for cutting out the face, and where its landmarks come from.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::clap::Args;
use serde::{Deserialize, Serialize};
use srflow_core::{Image, excerpt};
use srflow_data::micro_expression::Clip;
use srflow_face::{
    Face, FaceBox, FaceError, FaceFinder, FacePoints, FrameCrop, LandmarkTable, MODEL_SOURCES,
    write_landmarks,
};
use srflow_files::whole_number;
use srflow_mer::{FaceCrop, Landmarks};

use crate::Watch;
use crate::error::wrong_settings;

/// Environment variable with the place of MediaPipe's networks.
pub const FACE_MODELS_VARIABLE: &str = "SRFLOW_FACE_MODELS";

/// How faces are cut out; by default, frames are used whole.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FaceArgs {
    /// Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file
    /// to `--landmarks` to repeat the run without the networks
    #[arg(long, value_name = "detect", value_parser = ["detect"], conflicts_with_all = ["face_box", "landmarks"])]
    face: Option<String>,
    /// Face to use if there are several; 1 is the leftmost
    #[arg(long, value_name = "N", requires = "face", value_parser = clap::value_parser!(u16).range(1..))]
    face_index: Option<u16>,
    /// MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with
    /// face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the
    /// package that python3 has installed]
    #[arg(long, value_name = "PATH", requires = "face")]
    face_models: Option<PathBuf>,
    /// Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels
    #[arg(long, value_name = "BOX", conflicts_with = "landmarks")]
    face_box: Option<FaceBox>,
    /// Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md)
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
}

/// The face in a frame, and the crop that holds it.
pub struct FoundFace {
    pub points: Option<FacePoints>,
    pub crop: FrameCrop,
}

impl FaceArgs {
    /// Whether frames are used as they are.
    pub fn is_whole(&self) -> bool {
        self.face.is_none() && self.face_box.is_none() && self.landmarks.is_none()
    }

    /// Whether landmarks are detected, and not given.
    pub fn detects(&self) -> bool {
        self.face.is_some()
    }

    /// The box that is given, for a place that has no frames to find a face in.
    ///
    /// # Errors
    /// Names the setting that needs frames.
    pub fn still_box(&self) -> Result<Option<FaceBox>, &'static str> {
        match self {
            Self { face: Some(_), .. } => Err("face"),
            Self { landmarks: Some(_), .. } => Err("landmarks"),
            Self { face_box, .. } => Ok(*face_box),
        }
    }

    fn index(&self) -> Option<usize> {
        self.face_index.map(usize::from)
    }

    /// The networks, if faces are to be found.
    fn finder(&self) -> anyhow::Result<Option<FaceFinder>> {
        let Some(_) = &self.face else { return Ok(None) };
        Ok(Some(FaceFinder::read(&face_models(self.face_models.as_deref())?)?))
    }

    /// How the faces of clips are cut out. Those that are found are written to `file`.
    ///
    /// # Errors
    /// When landmarks cannot be read, found or written.
    pub fn of_clips<'a>(
        &self,
        clips: impl Iterator<Item = &'a Clip>,
        file: impl FnOnce() -> PathBuf,
        force: bool,
        watch: &Watch,
    ) -> anyhow::Result<FaceCrop> {
        if let Some(finder) = self.finder()? {
            let file = file();
            let clips: Vec<&Clip> = clips.collect();
            let faces = watch.count("faces", clips.len() as u64);
            let found = Landmarks::find(&clips, &finder, self.index(), &file, force, &|| faces.inc());
            return Ok(FaceCrop::Landmarks(found?));
        }
        Ok(match (&self.landmarks, self.face_box) {
            (Some(path), _) => {
                let landmarks = Landmarks::read(path)?;
                if let Some(note) = landmarks.note() {
                    log::warn!("{note}");
                }
                FaceCrop::Landmarks(landmarks)
            }
            (None, Some(face)) => FaceCrop::Fixed(face),
            (None, None) => FaceCrop::Whole,
        })
    }

    /// The face whose crop is that of all frames of a sequence: the first one that is found in these frames, or in a row of the landmarks.
    ///
    /// # Errors
    /// When a frame cannot be read, landmarks cannot be read, or there is no face.
    pub fn of_sequence(
        &self,
        frames: impl FnOnce(&mut dyn FnMut(anyhow::Result<Image>) -> bool),
    ) -> anyhow::Result<FoundFace> {
        let upright =
            |points: FacePoints| FoundFace { crop: FrameCrop::upright(&points), points: Some(points) };
        if let Some(finder) = self.finder()? {
            let mut found = Err(FaceError::NoFace.into());
            let mut looked = 0;
            frames(&mut |frame| {
                found = frame.and_then(|frame| Ok(finder.face(&frame, self.index())?.points));
                looked += 1;
                let none = found.as_ref().is_err_and(is_no_face);
                none && looked < MOST_LOOKED_AT
            });
            return Ok(upright(found?));
        }
        Ok(match (&self.landmarks, self.face_box) {
            (Some(path), _) => upright(first_of(path, &read_table(path, &[], &[])?)?),
            (None, Some(face)) => FoundFace { points: None, crop: FrameCrop::Fixed(face) },
            (None, None) => FoundFace { points: None, crop: FrameCrop::Whole },
        })
    }

    /// The face of a video, which is followed if it is detected, or if `landmarks` has rows of several frames.
    ///
    /// # Errors
    /// When landmarks or networks cannot be read.
    pub fn along(&self, video: &str) -> anyhow::Result<FaceTrack> {
        if let Some(finder) = self.finder()? {
            return Ok(FaceTrack::Found(Box::new(FoundTrack::new(finder, self.index()))));
        }
        let still = |points, crop| FaceTrack::Still(FoundFace { points, crop });
        Ok(match (&self.landmarks, self.face_box) {
            (Some(path), _) => {
                let table = read_table(path, &[], &[VIDEO, FRAME])?;
                let names_videos = table.rows().iter().any(|row| !row.keys[0].is_empty());
                let numbers_frames = table.rows().iter().any(|row| !row.keys[1].is_empty());
                if numbers_frames {
                    let mut frames = BTreeMap::new();
                    for row in table.rows().iter().filter(|row| !names_videos || row.keys[0] == video) {
                        let number = whole_number(&row.keys[1]).and_then(|number| i64::try_from(number).ok());
                        let Some(number) = number else {
                            wrong_settings!(
                                "{}: row {}, {FRAME}: expected a frame number, found {}",
                                path.display(),
                                row.line,
                                excerpt(&row.keys[1])
                            )
                        };
                        frames.insert(number, row.face.clone());
                    }
                    return match (frames.values().flatten().next(), frames.len()) {
                        (None, _) => Err(table.no_landmarks(video.to_owned(), None).into()),
                        (Some(points), 1) => Ok(still(Some(points.clone()), FrameCrop::upright(points))),
                        _ => Ok(FaceTrack::Table(frames)),
                    };
                }
                let points = match names_videos {
                    true => table.of(video)?.clone(),
                    false => first_of(path, &table)?,
                };
                still(Some(points.clone()), FrameCrop::upright(&points))
            }
            (None, Some(face)) => still(None, FrameCrop::Fixed(face)),
            (None, None) => still(None, FrameCrop::Whole),
        })
    }

    /// Finds the box about the face in single frames, such as the first ones of pairs.
    ///
    /// # Errors
    /// When landmarks cannot be read.
    pub fn boxes(&self) -> anyhow::Result<Option<FaceBoxes>> {
        let source = match (self.finder()?, &self.landmarks, self.face_box) {
            (Some(finder), ..) => BoxSource::Found(Box::new(finder), self.index()),
            (None, Some(path), _) => BoxSource::Table(read_table(path, &[PAIR], &[])?),
            (None, None, Some(face)) => BoxSource::Fixed(face),
            (None, None, None) => return Ok(None),
        };
        Ok(Some(FaceBoxes { source, found: Vec::new() }))
    }
}

/// Where MediaPipe's networks are, for jobs that always need them.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FaceModels {
    /// MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with
    /// face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the
    /// package that python3 has installed]
    #[arg(long, value_name = "PATH")]
    pub face_models: Option<PathBuf>,
}

impl FaceModels {
    /// Their place.
    ///
    /// # Errors
    /// Says where to get them when they are nowhere.
    pub fn path(&self) -> anyhow::Result<PathBuf> {
        face_models(self.face_models.as_deref())
    }
}

/// Where MediaPipe's networks are: in the path that is given, else in that of the environment, else in Python's package.
///
/// # Errors
/// Says where to get them when they are nowhere.
fn face_models(given: Option<&Path>) -> anyhow::Result<PathBuf> {
    let elsewhere = || std::env::var_os(FACE_MODELS_VARIABLE).map(PathBuf::from).or_else(installed_mediapipe);
    match given.map(Path::to_owned).or_else(elsewhere) {
        Some(path) => Ok(path),
        None => wrong_settings!(
            "finding faces needs {MODEL_SOURCES}; give it with `face_models` (python3 has no mediapipe installed)"
        ),
    }
}

/// In so many frames a face is looked for before a sequence is said to have none.
const MOST_LOOKED_AT: usize = 250;

fn is_no_face(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(FaceError::NoFace))
}

/// The face of the first row that has one; a note says which rows were skipped.
fn first_of(path: &Path, table: &LandmarkTable) -> anyhow::Result<FacePoints> {
    let (row, face) = table.first()?;
    if let Some(skipped) = table.rows().first().filter(|first| first.line != row.line) {
        log::warn!(
            "{}: in row {} the tracker found no face; the face of row {} is used",
            path.display(),
            skipped.line,
            row.line
        );
    }
    Ok(face.clone())
}

/// The face along a video.
pub enum FaceTrack {
    /// At one place in all frames.
    Still(FoundFace),
    /// By the landmarks of frames, by their numbers; `None` in frames without a face.
    Table(BTreeMap<i64, Option<FacePoints>>),
    /// Found by networks.
    Found(Box<FoundTrack>),
}

impl FaceTrack {
    /// The landmarks in the frame of this number; `None` if no face is there.
    ///
    /// # Errors
    /// When there are several faces, and none was chosen.
    pub fn points(&mut self, number: i64, frame: &Image) -> anyhow::Result<Option<FacePoints>> {
        match self {
            Self::Still(face) => Ok(face.points.clone()),
            Self::Table(frames) => Ok(frames.range(..=number).next_back().and_then(|(_, face)| face.clone())),
            Self::Found(track) => Ok(track.face(frame)?.map(|face| face.points)),
        }
    }
}

/// A face that networks find along a video; of several the one nearest to where it was.
pub struct FoundTrack {
    finder: FaceFinder,
    index: Option<usize>,
    last: Option<FacePoints>,
}

impl FoundTrack {
    /// In the first frame with a face it is the only one, or that of this number from 1 on, counted from the left.
    pub fn new(finder: FaceFinder, index: Option<usize>) -> Self {
        Self { finder, index, last: None }
    }

    pub fn finder(&self) -> &FaceFinder {
        &self.finder
    }

    /// The face in the next frame; `None` if no face is there.
    ///
    /// # Errors
    /// When there are several faces, and none was chosen.
    pub fn face(&mut self, frame: &Image) -> anyhow::Result<Option<Face>> {
        let found = match &self.last {
            None => match self.finder.face(frame, self.index) {
                Ok(face) => Some(face),
                Err(FaceError::NoFace) => None,
                Err(error) => return Err(error.into()),
            },
            Some(last) => {
                let away = |face: &Face| face.points.distance_to(last);
                self.finder.faces(frame)?.into_iter().min_by(|a, b| away(a).total_cmp(&away(b)))
            }
        };
        if let Some(face) = &found {
            self.last = Some(face.points.clone());
        }
        Ok(found)
    }
}

/// Reads a file of landmarks with these columns beside the points.
fn read_table(path: &Path, needed: &[&str], optional: &[&str]) -> anyhow::Result<LandmarkTable> {
    let table = LandmarkTable::read(path, needed, optional)?;
    if let Some(note) = table.note() {
        log::warn!("{note}");
    }
    Ok(table)
}

/// Column of the names of videos in a file of landmarks.
const VIDEO: &str = "video";

/// Column of the numbers of frames in a file of landmarks.
const FRAME: &str = "frame";

/// Column of the names of pairs in a file of landmarks.
const PAIR: &str = "pair";

/// See [`FaceArgs::boxes`].
pub struct FaceBoxes {
    source: BoxSource,
    found: Vec<(Vec<String>, FacePoints)>,
}

enum BoxSource {
    Found(Box<FaceFinder>, Option<usize>),
    Table(LandmarkTable),
    Fixed(FaceBox),
}

impl FaceBoxes {
    /// The box about the face in `frame`, the first one of this pair.
    ///
    /// # Errors
    /// A sentence, when there is no face, or landmarks are missing.
    pub fn of_pair(&mut self, pair: &str, frame: &Image) -> anyhow::Result<FaceBox> {
        let points = match &self.source {
            BoxSource::Fixed(face) => {
                FrameCrop::Fixed(*face).apply(frame)?;
                return Ok(*face);
            }
            BoxSource::Found(finder, index) => finder.face(frame, *index)?.points,
            BoxSource::Table(table) => table.of(pair)?.clone(),
        };
        let face = points.upright_box(frame.size())?;
        if matches!(self.source, BoxSource::Found(..)) {
            self.found.push((vec![pair.to_owned()], points));
        }
        Ok(face)
    }

    /// Writes the landmarks that were found; nothing if they were given.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path, force: bool) -> anyhow::Result<()> {
        if matches!(self.source, BoxSource::Found(..)) {
            write_landmarks(
                path,
                &[PAIR],
                force,
                self.found.iter().map(|(keys, points)| (keys.clone(), points)),
            )?;
        }
        Ok(())
    }
}

/// The folder of the package `mediapipe` of the first Python on the path.
fn installed_mediapipe() -> Option<PathBuf> {
    const FIND: &str =
        "import importlib.util as u; s = u.find_spec('mediapipe'); print(s.submodule_search_locations[0])";
    let of = |python: &str| {
        // Isolated, so that a file in the current folder is not taken for the package.
        let found = Command::new(python).args(["-I", "-c", FIND]).output().ok()?;
        let folder = PathBuf::from(String::from_utf8(found.stdout).ok()?.trim());
        (found.status.success() && folder.is_dir()).then_some(folder)
    };
    ["python3", "python"].into_iter().find_map(of)
}
