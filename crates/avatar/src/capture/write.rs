//! `transforms*.json` in VHAP's words.

use std::path::Path;

use glam::DMat4;
use serde::Serialize;
use srflow_files::{FileError, write_file};
use srflow_splat::Camera;

use super::{CaptureSplit, CaptureView};

/// Intrinsics in pixels from the corner of the first pixel, `cy` from the bottom; angles in radians.
#[derive(Serialize)]
struct Intrinsics {
    cx: f64,
    cy: f64,
    fl_x: f64,
    fl_y: f64,
    h: usize,
    w: usize,
    camera_angle_x: f64,
    camera_angle_y: f64,
}

impl Intrinsics {
    fn of(camera: &Camera) -> Self {
        let (width, height) = (camera.width as f64, camera.height as f64);
        let angle = |side: f64, focal: f64| 2.0 * libm::atan(side / (2.0 * focal));
        Self {
            cx: camera.cx + 0.5,
            cy: height - (camera.cy + 0.5),
            fl_x: camera.fx,
            fl_y: camera.fy,
            h: camera.height,
            w: camera.width,
            camera_angle_x: angle(width, camera.fx),
            camera_angle_y: angle(height, camera.fy),
        }
    }
}

#[derive(Serialize)]
struct Frame {
    timestep_index: u32,
    timestep_index_original: u32,
    timestep_id: String,
    camera_index: u32,
    camera_id: String,
    #[serde(flatten)]
    intrinsics: Intrinsics,
    /// World from camera in OpenGL's axes, by rows.
    transform_matrix: [[f64; 4]; 4],
    file_path: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    fg_mask_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    flame_param_path: Option<String>,
}

impl Frame {
    fn of(view: &CaptureView) -> Self {
        let text = |path: &Path| path.to_string_lossy().into_owned();
        Self {
            timestep_index: view.timestep,
            timestep_index_original: view.timestep,
            timestep_id: format!("{:05}", view.timestep),
            camera_index: view.camera_index,
            camera_id: format!("{:02}", view.camera_index),
            intrinsics: Intrinsics::of(&view.camera),
            transform_matrix: world_from_opengl(&view.camera),
            file_path: text(&view.image),
            fg_mask_path: view.mask.as_deref().map(text),
            flame_param_path: view.parameters.as_deref().map(text),
        }
    }
}

/// World from camera, with the axes x right, y up, z backward, by rows.
fn world_from_opengl(camera: &Camera) -> [[f64; 4]; 4] {
    let axes = camera.camera_from_world.transpose();
    let matrix = DMat4::from_cols(
        axes.x_axis.truncate().extend(0.0),
        -axes.y_axis.truncate().extend(0.0),
        -axes.z_axis.truncate().extend(0.0),
        camera.position().extend(1.0),
    );
    // Not `-0.0`, which is as good but reads oddly.
    matrix.transpose().to_cols_array_2d().map(|row| row.map(|value| value + 0.0))
}

#[derive(Serialize)]
struct Transforms {
    frames: Vec<Frame>,
    #[serde(flatten)]
    shared: Intrinsics,
    timestep_indices: Vec<u32>,
    camera_indices: Vec<u32>,
}

impl Transforms {
    fn of<'a>(views: impl Iterator<Item = &'a CaptureView> + Clone, shared: &Camera) -> Self {
        let sorted = |of: fn(&CaptureView) -> u32| {
            let mut indices: Vec<u32> = views.clone().map(of).collect();
            indices.sort_unstable();
            indices.dedup();
            indices
        };
        Self {
            shared: Intrinsics::of(shared),
            timestep_indices: sorted(|view| view.timestep),
            camera_indices: sorted(|view| view.camera_index),
            frames: views.map(Frame::of).collect(),
        }
    }
}

/// Writes `transforms.json` of all `views` into `dir`, and then `transforms_train.json`, `transforms_val.json` and
/// `transforms_test.json` of their splits. The paths in them are those of the views.
///
/// # Errors
/// When a file cannot be written.
pub fn write_transforms(dir: &Path, views: &[CaptureView]) -> Result<(), FileError> {
    let Some(last) = views.last() else { return Ok(()) };
    let write = |name: &str, transforms: &Transforms| {
        let text = serde_json::to_string_pretty(transforms).expect("numbers and text");
        write_file(&dir.join(name), text + "\n")
    };
    write("transforms.json", &Transforms::of(views.iter(), &last.camera))?;
    for split in CaptureSplit::ALL {
        let of_split = views.iter().filter(move |view| view.split == split);
        write(&format!("transforms_{split}.json"), &Transforms::of(of_split, &last.camera))?;
    }
    Ok(())
}
