//! What the readers of camera files share.

use std::path::Path;

use serde::de::DeserializeOwned;
use srflow_core::Size;
use srflow_files::FileProblem;

use super::Camera;
use crate::CameraError;

/// A camera of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedCamera {
    /// The name of its picture in the file; for a file of one camera, the file's own name.
    pub name: String,
    /// In the conventions of [`Camera`], and [valid](Camera::validate).
    pub camera: Camera,
    /// Non-zero lens distortion coefficients, such as `k1 = -0.03`; they are not part of the camera.
    pub distortion: Option<String>,
}

/// A file of one of the JSON formats.
pub(super) struct Source<'a> {
    pub(super) path: &'a Path,
    pub(super) bytes: &'a [u8],
    /// For cameras without a size in the file.
    pub(super) size: Option<Size>,
}

impl Source<'_> {
    pub(super) fn parse<T: DeserializeOwned>(&self) -> Result<T, FileProblem> {
        serde_json::from_slice(self.bytes).map_err(|error| problem("camera", "a JSON file of cameras", error))
    }

    /// The file's name, for a camera without one.
    pub(super) fn stem(&self) -> String {
        self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
    }
}

pub(super) fn problem(field: &'static str, expected: impl ToString, found: impl ToString) -> FileProblem {
    FileProblem::Field { field, expected: expected.to_string(), found: found.to_string() }
}

pub(super) fn invalid(name: &str, error: &CameraError) -> FileProblem {
    problem("camera", "a camera that can be rendered", format!("`{name}`: {error}"))
}

/// The non-zero coefficients, as text.
pub(super) fn distortion<'a>(coefficients: impl IntoIterator<Item = (&'a str, f64)>) -> Option<String> {
    let given: Vec<String> = coefficients
        .into_iter()
        .filter(|(_, value)| *value != 0.0)
        .map(|(name, value)| format!("{name} = {value}"))
        .collect();
    (!given.is_empty()).then(|| given.join(", "))
}
