//! What is known of a pair of frames beside its pictures: one small JSON file each.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_field::{FileKind, read_text};

use crate::statistics::FlowSummary;
use srflow_read::manifest::CameraRecord;

/// What `pairs/SCENE/NNNNN.json` holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    /// The first frame.
    pub frame1: FrameRecord,
    /// The second frame.
    pub frame2: FrameRecord,
    /// Forward flow on the head in frame 1.
    pub flow: FlowSummary,
}

/// Camera and motion at one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Number of the frame in its scene, from 0.
    pub frame: u32,
    /// Intrinsics and extrinsics.
    pub camera: CameraRecord,
    /// Where the camera stands about the head, relative to camera 9: azimuth, elevation and roll in degrees.
    pub view: [f64; 3],
    /// How the whole subject is turned: yaw, pitch and roll in degrees. It is part of the root joint's rotation.
    pub subject: [f64; 3],
    /// Weights of the head model's expressions by their names; those at zero are left out.
    pub expressions: BTreeMap<String, f32>,
    /// Rotation of each joint about its rest position, as quaternion `[x, y, z, w]`.
    pub joints: BTreeMap<String, [f32; 4]>,
    /// Translation of the head in metres.
    pub translation: [f32; 3],
    /// Where the eyes look relative to the head, in radians: to the subject's left and up.
    pub gaze: [f32; 2],
    /// Intensities of the action units shown, 0 to 1: `AU12_L` and `AU12_R` where a unit has halves, else `AU9`.
    pub action_units: BTreeMap<String, f32>,
}

/// What a JSON file for people to read holds.
pub(crate) fn json_text(content: &impl Serialize) -> String {
    serde_json::to_string_pretty(content).expect("numbers, text, lists and maps by text") + "\n"
}

/// Why a record could not be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}; delete the file and run `srflow render` again to make it", .path.display())]
pub struct RecordError {
    pub path: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

impl PairRecord {
    /// Reads a record.
    ///
    /// # Errors
    /// When it cannot be read or is not what `srflow render` writes.
    pub fn read(path: &Path) -> Result<Self, RecordError> {
        let failed = |reason| RecordError { path: path.to_owned(), reason };
        let text = read_text(path, FileKind::Json).map_err(|error| failed(error.problem.to_string()))?;
        serde_json::from_str(&text).map_err(|error| failed(srflow_field::parse_error_in_words(&error)))
    }
}
