//! The record of a pair of frames: one small JSON file each.

use std::collections::BTreeMap;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use srflow_files::{FileKind, read_text};

use crate::error::{RecordError, RenderError};
use crate::statistics::FlowSummary;
use srflow_data::manifest::CameraRecord;

/// The contents of `pairs/SCENE/NNNNN.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    pub frame1: FrameRecord,
    pub frame2: FrameRecord,
    /// Forward flow on the head in frame 1.
    pub flow: FlowSummary,
}

/// Camera and motion in one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Number of the frame in its scene, from 0.
    pub frame: u32,
    /// Intrinsics and extrinsics.
    pub camera: CameraRecord,
    /// The camera's position about the head, relative to camera 9: azimuth, elevation and roll in degrees.
    pub view: [f64; 3],
    /// Rotation of the whole subject: yaw, pitch and roll in degrees. It is part of the root joint's rotation.
    pub subject: [f64; 3],
    /// Weights of the head model's expressions by name, without zeros.
    pub expressions: BTreeMap<String, f32>,
    /// Rotation of each joint about its rest position, as quaternion `[x, y, z, w]`.
    pub joints: BTreeMap<String, [f32; 4]>,
    /// Translation of the head in metres.
    pub translation: [f32; 3],
    /// Gaze relative to the head, in radians: to the subject's left and up.
    pub gaze: [f32; 2],
    /// Intensities of the action units, 0 to 1: `AU12_L` and `AU12_R` where a unit has halves, else `AU9`.
    pub action_units: BTreeMap<String, f32>,
}

/// What a JSON file for people to read holds.
pub(crate) fn json_text(content: &impl Serialize) -> String {
    serde_json::to_string_pretty(content).expect("numbers, text, lists and maps by text") + "\n"
}

/// Reads a file that [`json_text`] has written.
///
/// # Errors
/// When it cannot be read, or has other content.
pub(crate) fn read_record<T: DeserializeOwned>(path: &Path) -> Result<T, RenderError> {
    let text = read_text(path, FileKind::Json)?;
    serde_json::from_str(&text).map_err(|error| malformed(path, &error))
}

/// The error of a record with other content.
pub(crate) fn malformed(path: &Path, error: &serde_json::Error) -> RenderError {
    RenderError::Malformed { path: path.to_owned(), reason: srflow_files::parse_error_in_words(error) }
}

impl PairRecord {
    /// Reads a record.
    ///
    /// # Errors
    /// When it cannot be read or does not have the format that `srflow render` writes.
    pub fn read(path: &Path) -> Result<Self, RecordError> {
        let failed = |reason| RecordError { path: path.to_owned(), reason };
        let text = read_text(path, FileKind::Json).map_err(|error| failed(error.problem.to_string()))?;
        serde_json::from_str(&text).map_err(|error| failed(srflow_files::parse_error_in_words(&error)))
    }
}
