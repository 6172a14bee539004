use std::path::Path;

use srflow_core::{Image, Size};

use crate::blendshapes::{self, BlendShapes};
use crate::detector::Extent;
use crate::model::{Model, Package};
use crate::points::FacePoints;
use crate::tflite::Network;
use crate::{FaceBox, FaceError, ModelError, detector, mesh};

/// The networks for faces that come together.
struct Networks {
    detector: Model,
    mesh: Model,
    blend_shapes: Option<Model>,
}

/// Those of the Python package.
const SOLUTIONS: Networks = Networks {
    detector: Model {
        name: "face_detection_short_range.tflite",
        folder: "face_detection",
        input: detector::INPUT,
        check: detector::check,
    },
    mesh: Model {
        name: "face_landmark.tflite",
        folder: "face_landmark",
        input: [3, 192, 192],
        check: mesh::check::<468>,
    },
    blend_shapes: None,
};

/// Those in `face_landmarker.task`, an archive.
const LANDMARKER: Networks = Networks {
    detector: Model {
        name: "face_detector.tflite",
        folder: "face_landmarker",
        input: detector::INPUT,
        check: detector::check,
    },
    mesh: Model {
        name: "face_landmarks_detector.tflite",
        folder: "face_landmarker",
        input: [3, 256, 256],
        check: mesh::check::<478>,
    },
    blend_shapes: Some(blendshapes::MODEL),
};

/// Finds faces and their points.
#[derive(Debug, Clone)]
pub struct FaceFinder {
    detector: Network,
    mesh: Network,
    blend_shapes: Option<Network>,
}

/// A face in a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Face {
    /// The detector's score, 0.5 to 1.
    pub score: f32,
    /// The 468 points of the face mesh, pixels; with the face landmarker's networks 478, the irises last.
    pub mesh: Vec<[f64; 2]>,
    /// Those that are nearest to dlib's 68.
    pub points: FacePoints,
}

impl Face {
    /// The box about its points, inside of a frame of this size.
    pub fn bounds(&self, Size { width, height }: Size) -> FaceBox {
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
    /// Reads the networks from `face_landmarker.task` or its folder, or from MediaPipe's package: its wheel, its folder, or any folder with
    /// `face_detection_short_range.tflite` and `face_landmark.tflite`.
    ///
    /// # Errors
    /// When a file is missing, damaged, or another network.
    pub fn read(path: &Path) -> Result<Self, FaceError> {
        let mut package = Package::open(path)?;
        let networks = if package.has(&LANDMARKER.mesh) { LANDMARKER } else { SOLUTIONS };
        Ok(Self {
            detector: package.read(&networks.detector)?,
            mesh: package.read(&networks.mesh)?,
            blend_shapes: networks.blend_shapes.map(|model| package.read(&model)).transpose()?,
        })
    }

    /// Number of points of the mesh, 468 or 478.
    pub fn mesh_points(&self) -> usize {
        self.mesh.output_lens()[0] / 3
    }

    /// Whether [`Self::blend_shapes`] has them.
    pub fn has_blend_shapes(&self) -> bool {
        self.blend_shapes.is_some()
    }

    /// How far a face shows each of [`BLEND_SHAPES`](crate::BLEND_SHAPES), 0 to 1; `None` without the face landmarker's networks.
    ///
    /// # Errors
    /// When the networks do not fit together.
    pub fn blend_shapes(&self, face: &Face) -> Result<Option<BlendShapes>, FaceError> {
        let Some(network) = &self.blend_shapes else { return Ok(None) };
        let failed = |problem: String| ModelError { path: blendshapes::MODEL.name.into(), problem };
        Ok(Some(blendshapes::of_mesh(network, &face.mesh).map_err(failed)?))
    }

    /// The faces of a frame, from left to right. Smaller ones than a tenth of the frame are found only where there is no larger one.
    ///
    /// # Errors
    /// When the networks do not fit together.
    pub fn faces(&self, frame: &Image) -> Result<Vec<Face>, FaceError> {
        if frame.pixels().is_empty() {
            return Ok(Vec::new());
        }
        let failed = |problem: String| ModelError { path: "MediaPipe's networks for faces".into(), problem };
        let mut faces: Vec<Face> = Vec::new();
        for extent in [Extent::Whole, Extent::Parts] {
            for (region, score) in detector::faces(&self.detector, frame, extent).map_err(failed)? {
                let Some(mesh) = mesh::points(&self.mesh, frame, &region).map_err(failed)? else { continue };
                if let Some(points) = FacePoints::of_mesh(&mesh) {
                    faces.push(Face { score, mesh, points });
                }
            }
            if !faces.is_empty() {
                break;
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
