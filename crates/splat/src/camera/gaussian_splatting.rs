//! `cameras.json` of 3D Gaussian Splatting (graphdeco-inria/gaussian-splatting, `utils/camera_utils.py`, `camera_to_JSON`): a
//! list of cameras in OpenCV's axes, each with its position in the world, its axes in the world as the columns of `rotation`,
//! and focal lengths in pixels. That project's rasterizer has no principal point: it is the centre of the picture.

use glam::{DMat3, DVec3};
use serde::Deserialize;
use srflow_core::Size;
use srflow_files::FileProblem;

use super::Camera;
use super::file::{NamedCamera, Source};

#[derive(Deserialize)]
struct Record {
    img_name: String,
    width: usize,
    height: usize,
    /// World from camera.
    position: [f64; 3],
    /// World from camera, in row-major order.
    rotation: [[f64; 3]; 3],
    fx: f64,
    fy: f64,
}

pub(super) fn cameras(source: &Source) -> Result<Vec<NamedCamera>, FileProblem> {
    let records: Vec<Record> = source.parse()?;
    let camera = |Record { img_name, width, height, position, rotation, fx, fy }: Record| NamedCamera {
        name: img_name,
        camera: Camera::centred(Size { width, height }, [fx, fy])
            .placed(DMat3::from_cols_array_2d(&rotation).transpose(), DVec3::from_array(position)),
        distortion: None,
    };
    Ok(records.into_iter().map(camera).collect())
}
