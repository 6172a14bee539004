//! Our own format: one camera, with the fields of [`Camera`].

use glam::DMat4;
use serde::Deserialize;
use srflow_files::FileProblem;

use super::Camera;
use super::file::{NamedCamera, Source};

#[derive(Deserialize)]
struct Record {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Camera from world, in row-major order.
    w2c: [[f64; 4]; 4],
}

pub(super) fn cameras(source: &Source) -> Result<Vec<NamedCamera>, FileProblem> {
    let Record { width, height, fx, fy, cx, cy, w2c } = source.parse()?;
    let camera_from_world = DMat4::from_cols_array_2d(&w2c).transpose();
    let camera = Camera { width, height, fx, fy, cx, cy, camera_from_world };
    Ok(vec![NamedCamera { name: source.stem(), camera, distortion: None }])
}
