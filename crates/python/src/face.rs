//! Faces in frames.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::exceptions::{PyFileNotFoundError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use srflow_face::{FacePoints, FrameCrop, MODEL_SOURCES};

use crate::arrays;
use crate::compute::compute;
use crate::errors::exception;

/// Finds faces and their landmarks with MediaPipe's networks, read from MediaPipe's own files.
///
/// `models` is its package up to version 0.10.21, as a folder or a .whl file, or a folder with `face_detection_short_range.tflite` and
/// `face_landmark.tflite`; by default `$SRFLOW_FACE_MODELS`, or the package that is installed. Nothing of it is executed.
///
/// Call it with a frame, uint8 H x W x 3 (RGB) or H x W. It returns a list of faces from left to right, each a dict: `score` (0.5 to 1), `box`
/// (left, top, width, height in pixels), `landmarks` (float64, 68 x 2: dlib's points, x and y in pixels) and `mesh` (float64, 468 x 2: those of
/// MediaPipe's face mesh).
#[pyclass(module = "srflow", frozen)]
pub struct FaceFinder {
    models: PathBuf,
    finder: Arc<srflow_face::FaceFinder>,
}

#[pymethods]
impl FaceFinder {
    #[new]
    #[pyo3(signature = (models: "str | os.PathLike[str] | None" = None) -> "FaceFinder")]
    fn new(py: Python<'_>, models: Option<PathBuf>) -> PyResult<Self> {
        let named = || std::env::var_os(srflow::face::FACE_MODELS_VARIABLE).map(PathBuf::from);
        let Some(models) = models.or_else(named).or_else(|| installed(py)) else {
            return Err(PyFileNotFoundError::new_err(format!(
                "models: expected {MODEL_SOURCES}; none is named, and mediapipe is not installed"
            )));
        };
        let path = models.clone();
        let finder = compute(py, move || srflow_face::FaceFinder::read(&path))?.map_err(exception)?;
        Ok(Self { models, finder: Arc::new(finder) })
    }

    #[pyo3(signature = (frame: "ArrayLike", /) -> "list[Face]")]
    fn __call__<'py>(&self, py: Python<'py>, frame: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let frame = arrays::image(frame, "frame")?;
        let (size, finder) = (frame.size(), self.finder.clone());
        let faces = compute(py, move || finder.faces(&frame))?.map_err(exception)?;
        let found = faces.into_iter().map(|face| {
            let bounds = face.bounds(size);
            let points = |points: Vec<[f64; 2]>| {
                let shape = [points.len(), 2];
                arrays::new_array(py, points.into_flattened(), &shape)
            };
            let found = PyDict::new(py);
            found.set_item("score", face.score)?;
            let bounds = PyTuple::new(py, [bounds.left, bounds.top, bounds.width, bounds.height])?;
            found.set_item("box", bounds)?;
            let landmarks = face.points.dlib.map_or(Vec::new(), |dlib| dlib.to_vec());
            found.set_item("landmarks", points(landmarks)?)?;
            found.set_item("mesh", points(face.mesh)?)?;
            Ok(found)
        });
        found.collect()
    }

    fn __repr__(&self) -> String {
        format!("srflow.FaceFinder({:?})", self.models.display().to_string())
    }
}

/// The folder of the package `mediapipe`, which is not imported.
fn installed(py: Python<'_>) -> Option<PathBuf> {
    let spec = py.import("importlib.util").ok()?.call_method1("find_spec", ("mediapipe",)).ok()?;
    let folders = spec.getattr("submodule_search_locations").ok()?;
    folders.try_iter().ok()?.next()?.ok()?.extract().ok()
}

/// The face of a frame, cut out and turned upright, as `srflow mer` and `srflow flow` do it: the eyes lie at 0.3 and 0.7 of the side and 0.36
/// of the height.
///
/// `frame` is uint8, H x W x 3 (RGB) or H x W; `landmarks` are dlib's 68 points or the two eyes, x and y in pixels, the left one in the picture
/// first. Crop all frames of a clip by the landmarks of one. Returns uint8, S x S x 3; outside of the frame its border is repeated.
#[pyfunction]
#[pyo3(signature = (frame: "ArrayLike", landmarks: "ArrayLike") -> "NDArray[np.uint8]")]
pub fn crop_face<'py>(
    py: Python<'py>,
    frame: &Bound<'py, PyAny>,
    landmarks: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let frame = arrays::image(frame, "frame")?;
    let expected = "dlib's points, float64 68 x 2, or the eyes, 2 x 2, apart from each other";
    let points: Vec<[f64; 2]> = arrays::rows(landmarks, "landmarks", expected)?;
    let finite = points.iter().flatten().all(|at| at.is_finite());
    let points = FacePoints::of(&points).filter(|_| finite);
    let points = points.ok_or_else(|| PyValueError::new_err(format!("landmarks: expected {expected}")))?;
    let crop = FrameCrop::upright(&points);
    arrays::from_image(py, compute(py, move || crop.apply(&frame))?.map_err(exception)?)
}
