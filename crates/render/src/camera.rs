//! Conversion of cameras to and from their stored form.

use glam::DMat4;
use srflow_data::manifest::CameraRecord;
use srflow_splat::Camera;

/// The camera as stored in `dataset.json`, pair records and `cam.json`.
pub fn record_from_camera(camera: &Camera) -> CameraRecord {
    let Camera { width, height, fx, fy, cx, cy, camera_from_world } = *camera;
    CameraRecord { width, height, fx, fy, cx, cy, w2c: camera_from_world.transpose().to_cols_array_2d() }
}

/// The camera of a record, unchecked; see [`Camera::validate`].
pub fn camera_from_record(record: &CameraRecord) -> Camera {
    let CameraRecord { width, height, fx, fy, cx, cy, w2c } = *record;
    Camera { width, height, fx, fy, cx, cy, camera_from_world: DMat4::from_cols_array_2d(&w2c).transpose() }
}
