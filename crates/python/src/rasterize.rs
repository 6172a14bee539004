//! Rasterizing Gaussians, and the gradients.

use std::sync::Arc;

use glam::Vec2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use srflow_core::{Size, parse_color};
use srflow_splat::{
    CameraGradient, Frame, FrameGradients, GaussianGradients, Next, Options, Outputs, PixelConvention,
    RasterizeError, Rasterizer, Sorting,
};

use crate::arrays;
use crate::camera::Camera;
use crate::compute::compute;
use crate::errors::exception;
use crate::gaussians::{Gaussians, vectors};

/// What a rendering depends on.
struct View {
    gaussians: Arc<srflow_splat::Gaussians>,
    camera: srflow_splat::Camera,
    next: Option<(Arc<srflow_splat::Gaussians>, srflow_splat::Camera)>,
    options: Options,
}

/// The options of a rendering, as keywords.
struct Keywords<'a, 'py> {
    background: Option<&'a Bound<'py, PyAny>>,
    sort_per_pixel: bool,
    antialiased: Option<bool>,
    pixel_convention: &'a str,
}

impl View {
    fn new(
        gaussians: &Gaussians,
        camera: &Camera,
        next: Option<&Gaussians>,
        camera_next: Option<&Camera>,
        keywords: Keywords<'_, '_>,
    ) -> PyResult<Self> {
        let Keywords { background, sort_per_pixel, antialiased, pixel_convention } = keywords;
        let convention = match pixel_convention {
            "splat" => PixelConvention::Splat,
            "paper" => PixelConvention::Paper,
            other => {
                return Err(PyValueError::new_err(format!(
                    "pixel_convention: expected \"splat\" or \"paper\", found {other:?}"
                )));
            }
        };
        let options = Options {
            background: background.map_or(Ok([0.0; 3]), color)?,
            convention,
            sorting: if sort_per_pixel { Sorting::PerPixel } else { Sorting::Global },
            outputs: Outputs::ALL,
        };
        let mut set = gaussians.inner.clone();
        if antialiased.is_some_and(|wanted| wanted != set.antialiased) {
            Arc::make_mut(&mut set).antialiased ^= true;
        }
        let moves = next.is_some() || camera_next.is_some();
        let next = moves.then(|| {
            let to = next.map_or_else(|| set.clone(), |next| next.inner.clone());
            (to, camera_next.unwrap_or(camera).inner)
        });
        Ok(Self { gaussians: set, camera: camera.inner, next, options })
    }

    fn next(&self) -> Option<Next<'_>> {
        self.next.as_ref().map(|(gaussians, camera)| Next { gaussians, camera })
    }
}

/// `"white"`, `"#ff8000"`, or three numbers, of which 0 to 1 is displayable.
fn color(object: &Bound<'_, PyAny>) -> PyResult<[f32; 3]> {
    if let Ok(name) = object.cast::<PyString>() {
        let name = name.to_string();
        let wrong = |error| PyValueError::new_err(format!("background: {error}, found {name:?}"));
        let bytes = parse_color(&name).map_err(wrong)?;
        return Ok(bytes.map(|channel| f32::from(channel) / 255.0));
    }
    arrays::vector(object, "background", "a colour, float32 3 (R, G, B from 0 to 1), or its name")
}

/// Renders 3D Gaussians: colour, alpha, depth and, towards `next`, exact optical flow, in one pass.
///
/// `next` are the same Gaussians after their motion, in the same order; only their means are used. `camera_next` is the camera that sees
/// them, of the same image size; by default the same camera. With one of the two there is flow.
///
/// `background` is a colour, (R, G, B) from 0 to 1, or a name as "white" or "#ff8000"; black by default. `sort_per_pixel` blends the
/// Gaussians in the order of their depth along each pixel's ray, so that nothing pops when the camera moves. `antialiased` replaces
/// what the Gaussians say themselves. `pixel_convention` "paper" makes the flow smaller by (S - 1) / S for an image side S, as in the
/// SRFlow paper.
///
/// Returns a dict of arrays, H x W each:
///
/// - `color`: float32, H x W x 3, before clamping; 0 to 1 is displayable. `image` is the same as uint8.
/// - `alpha`: float32, 0 to 1. `mask`: bool, alpha above one half.
/// - `depth`: float32, expected distance along the camera's axis in world units; 0 where nothing is visible.
/// - with flow, `flow`: float32, H x W x 2 in pixels, blended as colour is: not divided by alpha; `flow_normalized` is divided by it.
/// - with flow, `depth_next`: float32, expected depth of the same Gaussians in the next frame.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
#[pyo3(signature = (
    gaussians: "Gaussians",
    camera: "Camera",
    next: "Gaussians | None" = None,
    *,
    camera_next: "Camera | None" = None,
    background: "ArrayLike | str | None" = None,
    sort_per_pixel: "bool" = false,
    antialiased: "bool | None" = None,
    pixel_convention: "str" = "splat"
) -> "Frame")]
pub fn rasterize<'py>(
    py: Python<'py>,
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<&Gaussians>,
    camera_next: Option<&Camera>,
    background: Option<&Bound<'py, PyAny>>,
    sort_per_pixel: bool,
    antialiased: Option<bool>,
    pixel_convention: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let keywords = Keywords { background, sort_per_pixel, antialiased, pixel_convention };
    let view = View::new(gaussians, camera, next, camera_next, keywords)?;
    let has_flow = view.next.is_some();
    let frame = compute(py, move || {
        let mut frame = Frame::new();
        let View { gaussians, camera, options, .. } = &view;
        Rasterizer::new().render(gaussians, camera, view.next(), options, &mut frame)?;
        Ok::<_, RasterizeError>(frame)
    })?
    .map_err(exception)?;
    let dict = PyDict::new(py);
    let shape = [frame.height, frame.width, 3];
    dict.set_item("mask", arrays::from_mask(py, frame.mask())?)?;
    if has_flow {
        dict.set_item("flow_normalized", arrays::from_flow(py, frame.flow_normalized())?)?;
        dict.set_item("flow", arrays::from_flow(py, frame.flow)?)?;
        dict.set_item("depth_next", arrays::from_plane(py, frame.depth_next)?)?;
    }
    dict.set_item("color", arrays::new_array(py, frame.color.into_flattened(), &shape)?)?;
    dict.set_item("image", arrays::from_image(py, frame.image)?)?;
    dict.set_item("alpha", arrays::from_plane(py, frame.alpha)?)?;
    dict.set_item("depth", arrays::from_plane(py, frame.depth)?)?;
    Ok(dict)
}

/// The outputs that can have a gradient, and the values of each at a pixel.
const DIFFERENTIABLE: [(&str, usize); 5] =
    [("color", 3), ("alpha", 1), ("depth", 1), ("flow", 2), ("depth_next", 1)];

/// The gradients of an image of this size that `given` has.
fn gradients_of(given: &Bound<'_, PyDict>, Size { width, height }: Size) -> PyResult<FrameGradients> {
    let known = DIFFERENTIABLE.map(|(name, _)| name);
    for name in given.keys() {
        let name = name.to_string();
        if !known.contains(&name.as_str()) {
            let known = known.join(", ");
            return Err(PyValueError::new_err(format!(
                "gradients: expected some of {known}; found {name:?}"
            )));
        }
    }
    let mut lists = Vec::new();
    for (name, channels) in DIFFERENTIABLE {
        let shape = if channels == 1 { vec![height, width] } else { vec![height, width, channels] };
        let text = shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(" x ");
        let values = match given.get_item(name)?.filter(|value| !value.is_none()) {
            None => Vec::new(),
            Some(value) => {
                let name = format!("gradients[{name:?}]");
                arrays::shaped::<f32>(&value, &name, &format!("float32 {text}"), &shape)?
            }
        };
        lists.push(values);
    }
    let [color, alpha, depth, flow, depth_next] = lists.try_into().unwrap_or_default();
    let (color, flow) = (color.as_chunks().0.to_vec(), flow.as_chunks().0.to_vec());
    Ok(FrameGradients { color, alpha, depth, flow, depth_next })
}

/// The gradients of a loss with respect to Gaussians and cameras.
///
/// `gradients` are those of the loss with respect to outputs of `rasterize`: a dict with any of `color`, `alpha`, `depth`, `flow` and
/// `depth_next`, float32 in the shape of the output. The other arguments are those of that `rasterize`, whose rendering is made again.
///
/// Returns a dict:
///
/// - `means`, `scales`, `rotations`, `opacities`, `sh`: float32 in the shapes of the Gaussians; with flow, `means_next` too.
/// - `camera` and, with flow, `camera_next`: dicts of `translation` and `rotation` (float64, 3: of a motion after `camera_from_world`, in
///   the camera's axes, per world unit and per radian), `fx`, `fy`, `cx`, `cy`.
/// - `centers`, `centers_absolute`: float32, N x 2, of the centres on the image in pixels through the blending weights alone, and the
///   same with absolute values summed: what adaptive density control measures.
/// - `visible`: bool, N, whether each Gaussian can touch a pixel.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
#[pyo3(signature = (
    gradients: "dict[str, Any]",
    gaussians: "Gaussians",
    camera: "Camera",
    next: "Gaussians | None" = None,
    *,
    camera_next: "Camera | None" = None,
    background: "ArrayLike | str | None" = None,
    sort_per_pixel: "bool" = false,
    antialiased: "bool | None" = None,
    pixel_convention: "str" = "splat"
) -> "Gradients")]
pub fn rasterize_backward<'py>(
    py: Python<'py>,
    gradients: &Bound<'py, PyDict>,
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<&Gaussians>,
    camera_next: Option<&Camera>,
    background: Option<&Bound<'py, PyAny>>,
    sort_per_pixel: bool,
    antialiased: Option<bool>,
    pixel_convention: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let keywords = Keywords { background, sort_per_pixel, antialiased, pixel_convention };
    let mut view = View::new(gaussians, camera, next, camera_next, keywords)?;
    view.options.outputs = Outputs::NONE;
    let gradients = gradients_of(gradients, view.camera.size())?;
    let has_flow = view.next.is_some();
    let needs_next = !gradients.flow.is_empty() || !gradients.depth_next.is_empty();
    if needs_next && !has_flow {
        return Err(PyValueError::new_err(
            "gradients: flow and depth_next need the next frame: give `next` or `camera_next`",
        ));
    }
    let (n, sh_len) = (view.gaussians.len(), view.gaussians.sh_len());
    let (out, visible) = compute(py, move || {
        let mut rasterizer = Rasterizer::new();
        let View { gaussians, camera, options, .. } = &view;
        let mut rendering = rasterizer.render(gaussians, camera, view.next(), options, &mut Frame::new())?;
        let mut out = GaussianGradients::default();
        rendering.backward(&gradients, &mut out)?;
        let visible: Vec<bool> = rendering.visible().collect();
        Ok::<_, RasterizeError>((out, visible))
    })?
    .map_err(exception)?;
    let dict = PyDict::new(py);
    let rotations = out.rotations.iter().flat_map(|rotation| rotation.to_array()).collect();
    dict.set_item("means", vectors(py, &out.positions)?)?;
    dict.set_item("scales", vectors(py, &out.scales)?)?;
    dict.set_item("rotations", arrays::new_array::<f32>(py, rotations, &[n, 4])?)?;
    dict.set_item("opacities", arrays::new_array(py, out.opacities, &[n])?)?;
    dict.set_item("sh", arrays::new_array(py, out.sh.into_flattened(), &[n, sh_len, 3])?)?;
    dict.set_item("centers", points(py, &out.centers)?)?;
    dict.set_item("centers_absolute", points(py, &out.centers_absolute)?)?;
    dict.set_item("visible", arrays::new_array(py, visible, &[n])?)?;
    dict.set_item("camera", of_camera(py, &out.camera)?)?;
    if has_flow {
        dict.set_item("means_next", vectors(py, &out.next_positions)?)?;
        dict.set_item("camera_next", of_camera(py, &out.next_camera)?)?;
    }
    Ok(dict)
}

fn points<'py>(py: Python<'py>, points: &[Vec2]) -> PyResult<Bound<'py, PyAny>> {
    let values = points.iter().flat_map(|point| point.to_array()).collect();
    arrays::new_array::<f32>(py, values, &[points.len(), 2])
}

fn of_camera<'py>(py: Python<'py>, gradient: &CameraGradient) -> PyResult<Bound<'py, PyDict>> {
    let CameraGradient { translation, rotation, fx, fy, cx, cy } = gradient;
    let dict = PyDict::new(py);
    for (name, vector) in [("translation", translation), ("rotation", rotation)] {
        dict.set_item(name, arrays::new_array(py, vector.to_array().to_vec(), &[3])?)?;
    }
    for (name, value) in [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)] {
        dict.set_item(name, value)?;
    }
    Ok(dict)
}
