use std::path::Path;

use srflow_core::Image;
use srflow_files::{FileKind, open_zip, read_file};

use crate::points::FacePoints;
use crate::tflite::Network;
use crate::{FaceBox, FaceError, ModelError, detector, mesh};

/// Where the networks come from, for messages and help.
pub const MODEL_SOURCES: &str = "the networks of MediaPipe, which are in its package up to version 0.10.21: `pip download \
    --no-deps --only-binary=:all: --python-version 3.11 --platform manylinux_2_28_x86_64 mediapipe==0.10.21` gets a file \
    mediapipe-0.10.21-....whl, which works on every system";

const DETECTOR: &str = "face_detection_short_range.tflite";
const MESH: &str = "face_landmark.tflite";
/// No network of MediaPipe's for faces is larger, in bytes.
const LARGEST_MODEL: u64 = 64 << 20;

/// Finds faces and their points.
#[derive(Debug, Clone)]
pub struct FaceFinder {
    detector: Network,
    mesh: Network,
}

/// A face in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Face {
    /// The detector's score, 0.5 to 1.
    pub score: f32,
    /// The 468 points of the face mesh, pixels.
    pub mesh: Vec<[f64; 2]>,
    /// Those that are nearest to dlib's 68.
    pub points: FacePoints,
}

impl Face {
    /// The box about its points, inside of a frame of this size.
    pub fn bounds(&self, (width, height): (usize, usize)) -> FaceBox {
        let range = |axis: usize, size: usize| {
            let all = || self.mesh.iter().map(|point| point[axis]);
            let last = size.saturating_sub(1) as f64;
            let low = all().fold(f64::INFINITY, f64::min).clamp(0.0, last).floor();
            let high = all().fold(f64::NEG_INFINITY, f64::max).clamp(low, last).ceil();
            (low as usize, (high - low) as usize + 1)
        };
        let ((left, width), (top, height)) = (range(0, width), range(1, height));
        FaceBox { left, top, width, height }
    }
}

impl FaceFinder {
    /// Reads the networks from MediaPipe's package: its wheel, its folder, or any folder with `face_detection_short_range.tflite` and
    /// `face_landmark.tflite`.
    ///
    /// # Errors
    /// When a file is missing, damaged, or another network.
    pub fn read(path: &Path) -> Result<Self, FaceError> {
        let load =
            |name: &str, folder: &str, check: fn(&Network) -> Result<(), String>, input: [usize; 2]| {
                let (bytes, found) = model_file(path, name, folder)?;
                let network = Network::parse(&bytes).and_then(|network| {
                    if network.input() != input {
                        let [height, width] = network.input();
                        return Err(format!(
                            "expected a network for {}x{} pixels, found {width}x{height}",
                            input[1], input[0]
                        ));
                    }
                    check(&network).map(|()| network)
                });
                network.map_err(|problem| FaceError::from(ModelError { path: found, problem }))
            };
        Ok(Self {
            detector: load(DETECTOR, "face_detection", detector::check, detector::INPUT)?,
            mesh: load(MESH, "face_landmark", mesh::check, mesh::INPUT)?,
        })
    }

    /// All faces of a frame, from left to right.
    ///
    /// # Errors
    /// When the networks do not fit together.
    pub fn faces(&self, frame: &Image) -> Result<Vec<Face>, FaceError> {
        if frame.pixels().is_empty() {
            return Ok(Vec::new());
        }
        let failed = |problem: String| ModelError { path: DETECTOR.into(), problem };
        let mut faces: Vec<Face> = Vec::new();
        for (region, score) in detector::faces(&self.detector, frame).map_err(failed)? {
            let Some(mesh) = mesh::points(&self.mesh, frame, &region).map_err(failed)? else { continue };
            if let Some(points) = FacePoints::of_mesh(&mesh) {
                faces.push(Face { score, mesh, points });
            }
        }
        let x = |face: &Face| face.points.eyes[0][0] + face.points.eyes[1][0];
        faces.sort_by(|a, b| x(a).total_cmp(&x(b)));
        Ok(faces)
    }

    /// The face of a frame: the only one, or that of this number from 1 on, counted from the left.
    ///
    /// # Errors
    /// When there is none, when there are several and `index` is `None`, and when there are fewer.
    pub fn face(&self, frame: &Image, index: Option<usize>) -> Result<Face, FaceError> {
        let mut faces = self.faces(frame)?;
        match (faces.len(), index) {
            (0, _) => Err(FaceError::NoFace),
            (1, None) => Ok(faces.remove(0)),
            (_, None) => Err(FaceError::Several {
                boxes: faces.iter().map(|face| face.bounds(frame.size())).collect(),
            }),
            (found, Some(index)) if (1..=found).contains(&index) => Ok(faces.remove(index - 1)),
            (found, Some(index)) => Err(FaceError::NoSuchFace { index, found }),
        }
    }
}

/// The bytes of a network, and the file that they are from.
fn model_file(path: &Path, name: &str, folder: &str) -> Result<(Vec<u8>, std::path::PathBuf), FaceError> {
    let missing = |found: String| ModelError {
        path: path.to_owned(),
        problem: format!("expected {MODEL_SOURCES}, or a folder with its files; found {found}"),
    };
    if path.is_dir() {
        let places = [path.join(name), path.join("modules").join(folder).join(name)];
        let Some(file) = places.into_iter().find(|file| file.exists()) else {
            return Err(missing(format!("no {name}")).into());
        };
        return Ok((read_file(&file, FileKind::Network)?, file));
    }
    let bytes = read_file(path, FileKind::Network)?;
    let mut zip =
        open_zip(bytes).map_err(|problem| missing(format!("a file that is no whole .whl ({problem})")))?;
    let names = zip.file_names().filter_map(Result::ok);
    let mut named =
        names.filter(|entry| entry.rsplit('/').next() == Some(name)).map(|entry| entry.into_owned());
    let Some(entry) = named.next() else {
        return Err(missing(format!("no {name} inside")).into());
    };
    drop(named);
    let damaged = |error: &dyn std::fmt::Display| ModelError {
        path: path.to_owned(),
        problem: format!("{entry}: {error}; get the file again"),
    };
    let file = zip.by_name(&entry).map_err(|error| damaged(&error))?;
    let mut bytes = Vec::new();
    let read = std::io::Read::read_to_end(&mut std::io::Read::take(file, LARGEST_MODEL), &mut bytes);
    read.map_err(|error| damaged(&error))?;
    Ok((bytes, path.join(entry)))
}
