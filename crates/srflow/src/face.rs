//! Arguments for cutting out the face, and where its landmarks come from.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::clap::Args;
use serde::{Deserialize, Serialize};
use srflow_core::Image;
use srflow_data::micro_expression::Clip;
use srflow_face::{
    FaceBox, FaceFinder, FacePoints, FrameCrop, LandmarkTable, MODEL_SOURCES, write_landmarks,
};
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
    /// MediaPipe's package, as a folder or .whl file, or a folder with face_detection_short_range.tflite and
    /// face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed]
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

    fn index(&self) -> Option<usize> {
        self.face_index.map(usize::from)
    }

    /// The networks, if faces are to be found.
    fn finder(&self) -> anyhow::Result<Option<FaceFinder>> {
        let Some(_) = &self.face else { return Ok(None) };
        let models = match (&self.face_models, std::env::var_os(FACE_MODELS_VARIABLE)) {
            (Some(path), _) => path.clone(),
            (None, Some(path)) => path.into(),
            (None, None) => match installed_mediapipe() {
                Some(folder) => folder,
                None => wrong_settings!(
                    "`face` detect needs {MODEL_SOURCES}; give it with `face_models` (python3 has no mediapipe installed)"
                ),
            },
        };
        Ok(Some(FaceFinder::read(&models)?))
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

    /// The face in the first frame of a sequence, whose crop is that of all its frames: with `--landmarks`, that of the first row with a face.
    ///
    /// # Errors
    /// When landmarks cannot be read or found.
    pub fn of_first_frame(&self, first: &Image) -> anyhow::Result<FoundFace> {
        self.of_video("", first)
    }

    /// As [`of_first_frame`](Self::of_first_frame), for one of several videos, which `landmarks` with a column `video` name.
    ///
    /// # Errors
    /// When landmarks cannot be read or found.
    pub fn of_video(&self, name: &str, first: &Image) -> anyhow::Result<FoundFace> {
        let upright =
            |points: FacePoints| FoundFace { crop: FrameCrop::upright(&points), points: Some(points) };
        if let Some(finder) = self.finder()? {
            return Ok(upright(finder.face(first, self.index())?.points));
        }
        Ok(match (&self.landmarks, self.face_box) {
            (Some(path), _) => {
                let table = read_table(path, &[], &[VIDEO])?;
                let names_videos =
                    table.rows().iter().any(|row| row.keys.iter().any(|name| !name.is_empty()));
                if names_videos && !name.is_empty() {
                    return Ok(upright(table.of(name)?.clone()));
                }
                let (row, face) = table.first()?;
                if let Some(skipped) = table.rows().first().filter(|first| first.line != row.line) {
                    log::warn!(
                        "{}: in row {} the tracker found no face; the face of row {} is used",
                        path.display(),
                        skipped.line,
                        row.line
                    );
                }
                upright(face.clone())
            }
            (None, Some(face)) => FoundFace { points: None, crop: FrameCrop::Fixed(face) },
            (None, None) => FoundFace { points: None, crop: FrameCrop::Whole },
        })
    }

    /// Finds the box about the face in single frames, such as the first ones of pairs.
    ///
    /// # Errors
    /// When landmarks cannot be read.
    pub fn boxes(&self) -> anyhow::Result<Option<FaceBoxes>> {
        let source = match (self.finder()?, &self.landmarks, self.face_box) {
            (Some(finder), ..) => BoxSource::Found(finder, self.index()),
            (None, Some(path), _) => BoxSource::Table(read_table(path, &[PAIR], &[])?),
            (None, None, Some(face)) => BoxSource::Fixed(face),
            (None, None, None) => return Ok(None),
        };
        Ok(Some(FaceBoxes { source, found: Vec::new() }))
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

/// Column of the names of pairs in a file of landmarks.
const PAIR: &str = "pair";

/// See [`FaceArgs::boxes`].
pub struct FaceBoxes {
    source: BoxSource,
    found: Vec<(Vec<String>, FacePoints)>,
}

enum BoxSource {
    Found(FaceFinder, Option<usize>),
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
