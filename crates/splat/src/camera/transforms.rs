//! `transforms.json`: of NeRF's synthetic scenes (bmild/nerf, `load_blender.py`), and with more keys of instant-ngp,
//! nerfstudio (`nerfstudio_dataparser.py`) and VHAP (`vhap/export_as_nerf_dataset.py`), which GaussianAvatars is trained on.
//!
//! `transform_matrix` is world from camera in OpenGL's axes (x right, y up, z backward). Focal lengths are in pixels (`fl_x`,
//! `fl_y`), or given by the horizontal field of view (`camera_angle_x`): `f = w / (2 tan(angle / 2))`. The principal point is
//! relative to the corner of the first pixel; ours to its centre. VHAP, whose frames have a `timestep_index` and a
//! `camera_index`, counts `cy` from the bottom (`vhap/util/camera.py`, `convert_camera_convention`), all others from the top. Each
//! intrinsic may be at the root, in a frame, or both; the frame's takes precedence, whether focal length or angle. instant-ngp marks
//! lenses that are no pinholes by flags (`nerf_loader.cu`).

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde::de::IgnoredAny;
use srflow_core::Size;
use srflow_files::{FileProblem, read_image_size};

use super::Camera;
use super::file::{NamedCamera, Source, distortion, problem};

/// Camera models that are pinholes apart from distortion; other models of nerfstudio (fisheye, equirectangular) are not.
const PINHOLES: [&str; 6] = ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL"];

#[derive(Deserialize)]
struct Transforms {
    #[serde(flatten)]
    shared: Intrinsics,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    /// World from camera, in row-major order; the last row may be missing.
    transform_matrix: Vec<[f64; 4]>,
    timestep_index: Option<IgnoredAny>,
    camera_index: Option<IgnoredAny>,
    #[serde(flatten)]
    own: Intrinsics,
}

/// The intrinsics that are present, under their names in the file.
#[derive(Deserialize)]
struct Intrinsics {
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_model: Option<String>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    is_fisheye: Option<bool>,
    latlong: Option<bool>,
    equirectangular: Option<bool>,
    orthographic: Option<bool>,
    ftheta_p0: Option<f64>,
}

impl Intrinsics {
    /// Names and values of the lens distortion.
    fn distortion(&self) -> [(&'static str, Option<f64>); 6] {
        let Self { k1, k2, k3, k4, p1, p2, .. } = *self;
        [("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4), ("p1", p1), ("p2", p2)]
    }

    /// The flag of a lens that is no pinhole.
    fn other_lens(&self) -> Option<&'static str> {
        let flags = [
            ("is_fisheye", self.is_fisheye),
            ("latlong", self.latlong),
            ("equirectangular", self.equirectangular),
            ("orthographic", self.orthographic),
            ("ftheta_p0", self.ftheta_p0.map(|_| true)),
        ];
        flags.into_iter().find_map(|(name, set)| set.unwrap_or(false).then_some(name))
    }

    /// Focal length along the width, in pixels.
    fn horizontal(&self, width: f64) -> Option<f64> {
        self.fl_x.or_else(|| Some(of_angle(width, self.camera_angle_x?)))
    }

    fn vertical(&self, height: f64) -> Option<f64> {
        self.fl_y.or_else(|| Some(of_angle(height, self.camera_angle_y?)))
    }
}

/// Focal length of an angle of view in radians.
fn of_angle(side: f64, angle: f64) -> f64 {
    side / (2.0 * (angle / 2.0).tan())
}

pub(super) fn cameras(source: &Source) -> Result<Vec<NamedCamera>, FileProblem> {
    let Transforms { shared, frames } = source.parse()?;
    frames.into_iter().map(|frame| camera(frame, &shared, source)).collect()
}

fn camera(frame: Frame, shared: &Intrinsics, source: &Source) -> Result<NamedCamera, FileProblem> {
    let Frame { file_path, transform_matrix, timestep_index, camera_index, own } = frame;
    // As Windows writes it.
    let name = file_path.replace('\\', "/");
    let of_vhap = timestep_index.is_some() && camera_index.is_some();
    if let Some(model) = own.camera_model.as_ref().or(shared.camera_model.as_ref())
        && !PINHOLES.contains(&model.as_str())
    {
        let expected = format!("a pinhole camera ({})", PINHOLES.join(", "));
        return Err(problem("camera_model", expected, format!("`{model}` for `{name}`")));
    }
    if let Some(flag) = own.other_lens().or(shared.other_lens()) {
        return Err(problem(flag, "a pinhole camera", format!("another lens for `{name}`")));
    }
    let given = |value: fn(&Intrinsics) -> Option<f64>| value(&own).or(value(shared));
    let size = match (given(|i| i.w), given(|i| i.h)) {
        (Some(w), Some(h)) => Size { width: pixels("w", w, &name)?, height: pixels("h", h, &name)? },
        _ => match source.size {
            Some(size) => size,
            None => size_of_picture(source.path, &name)?,
        },
    };
    let (width, height) = (size.width as f64, size.height as f64);
    let fx = own.horizontal(width).or(shared.horizontal(width));
    let fx = fx.ok_or_else(|| {
        problem("fl_x", "a focal length, or camera_angle_x", format!("neither for `{name}`"))
    })?;
    // An angle alone means square pixels.
    let square = (own.fl_x.is_none() && own.camera_angle_x.is_some()).then_some(fx);
    let fy = own.vertical(height).or(square).or(shared.vertical(height)).unwrap_or(fx);
    let (rotation, position) = world_from_opengl(&transform_matrix, &name)?;
    let mut camera = Camera::centred(size, [fx, fy]).placed(rotation, position);
    camera.cx = given(|i| i.cx).map_or(camera.cx, |cx| cx - 0.5);
    let from_top = |cy: f64| if of_vhap { height - cy } else { cy };
    camera.cy = given(|i| i.cy).map_or(camera.cy, |cy| from_top(cy) - 0.5);
    let coefficients = own.distortion().into_iter().zip(shared.distortion());
    let distortion =
        distortion(coefficients.map(|((name, own), (_, shared))| (name, own.or(shared).unwrap_or(0.0))));
    Ok(NamedCamera { name, camera, distortion })
}

/// Rotation (OpenCV's axes) and position of a camera in the world, from world from camera in OpenGL's axes.
pub(super) fn world_from_opengl(rows: &[[f64; 4]], name: &str) -> Result<(DMat3, DVec3), FileProblem> {
    let whole = match rows {
        [_, _, _] => true,
        [_, _, _, last] => *last == [0.0, 0.0, 0.0, 1.0],
        _ => false,
    };
    if !whole {
        let expected = "3 rows of 4 numbers, or a fourth of 0 0 0 1";
        return Err(problem("transform_matrix", expected, format!("{rows:?} for `{name}`")));
    }
    let column = |at: usize| DVec3::new(rows[0][at], rows[1][at], rows[2][at]);
    Ok((DMat3::from_cols(column(0), -column(1), -column(2)), column(3)))
}

fn pixels(field: &'static str, value: f64, name: &str) -> Result<usize, FileProblem> {
    match value {
        // instant-ngp writes integers as 800.0.
        value if value.fract() == 0.0 && (1.0..=4e9).contains(&value) => Ok(value as usize),
        _ => Err(problem(field, "an integer number of pixels", format!("{value} for `{name}`"))),
    }
}

/// NeRF's own files have no size: it is that of the pictures, which are listed without extension.
fn size_of_picture(file: &Path, name: &str) -> Result<Size, FileProblem> {
    let place = file.parent().unwrap_or(Path::new("")).join(name);
    let with_extension =
        place.with_file_name(format!("{}.png", place.file_name().unwrap_or_default().to_string_lossy()));
    read_image_size(&place).or_else(|_| read_image_size(&with_extension)).map_err(|error| {
        problem(
            "w and h",
            "the size of the pictures (give `size`)",
            format!("none for `{name}`, and {error}"),
        )
    })
}
