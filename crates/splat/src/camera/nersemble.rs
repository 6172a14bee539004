//! `camera_params.json` of NeRSemble (Kirschstein et al. 2023), as VHAP reads it (`vhap/data/nersemble_dataset.py`,
//! `load_camera_params`): camera from world in OpenCV's axes by the serial number of each camera, and one matrix of intrinsics for
//! all. The principal point is relative to the corner of the first pixel; ours to its centre.

use std::collections::BTreeMap;

use glam::DMat4;
use serde::Deserialize;
use srflow_core::Size;
use srflow_files::FileProblem;

use super::Camera;
use super::file::{NamedCamera, Source, problem};

/// Size during calibration where the file has none (`vhap/config/nersemble.py`).
const CALIBRATED_SIZE: Size = Size::new(2200, 3208);

#[derive(Deserialize)]
struct Parameters {
    /// Camera from world, in row-major order.
    world_2_cam: BTreeMap<String, [[f64; 4]; 4]>,
    intrinsics: [[f64; 3]; 3],
    width: Option<usize>,
    height: Option<usize>,
}

/// The cameras, sorted by serial number.
pub(super) fn cameras(source: &Source) -> Result<Vec<NamedCamera>, FileProblem> {
    let Parameters { world_2_cam, intrinsics, width, height } = source.parse()?;
    let given = width.zip(height).map(|(width, height)| Size { width, height });
    let Size { width, height } = given.unwrap_or(CALIBRATED_SIZE);
    let [[fx, skew, cx], [below, fy, cy], last] = intrinsics;
    if skew != 0.0 || below != 0.0 || last != [0.0, 0.0, 1.0] {
        let expected = "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]";
        return Err(problem("intrinsics", expected, format!("{intrinsics:?}")));
    }
    let camera = |(name, w2c): (String, [[f64; 4]; 4])| {
        let camera_from_world = DMat4::from_cols_array_2d(&w2c).transpose();
        let camera = Camera { width, height, fx, fy, cx: cx - 0.5, cy: cy - 0.5, camera_from_world };
        NamedCamera { name, camera, distortion: None }
    };
    Ok(world_2_cam.into_iter().map(camera).collect())
}
