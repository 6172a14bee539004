//! A camera path saved by nerfstudio's viewer (`nerfstudio/cameras/camera_paths.py`, `get_path_from_json`): world from camera
//! in OpenGL's axes, 16 numbers in row-major order, and the vertical field of view in degrees.

use serde::Deserialize;
use srflow_core::Size;
use srflow_files::FileProblem;

use super::Camera;
use super::file::{NamedCamera, Source, problem};
use super::transforms::world_from_opengl;

#[derive(Deserialize)]
struct Path {
    render_width: usize,
    render_height: usize,
    camera_type: Option<String>,
    camera_path: Vec<Stop>,
}

#[derive(Deserialize)]
struct Stop {
    camera_to_world: [f64; 16],
    fov: f64,
}

pub(super) fn cameras(source: &Source) -> Result<Vec<NamedCamera>, FileProblem> {
    let Path { render_width, render_height, camera_type, camera_path } = source.parse()?;
    if let Some(other) = camera_type.filter(|camera_type| camera_type != "perspective") {
        return Err(problem("camera_type", "`perspective`", format!("`{other}`")));
    }
    let camera = |(number, Stop { camera_to_world, fov }): (usize, Stop)| {
        let name = format!("{number}");
        let (rows, _) = camera_to_world.as_chunks();
        let (rotation, position) = world_from_opengl(rows, &name)?;
        let focal = render_height as f64 / (2.0 * (fov.to_radians() / 2.0).tan());
        let camera =
            Camera::centred(Size::new(render_width, render_height), [focal; 2]).placed(rotation, position);
        Ok(NamedCamera { name, camera, distortion: None })
    };
    camera_path.into_iter().enumerate().map(camera).collect()
}
