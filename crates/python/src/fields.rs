//! Flow files, colours, warping and scores.

use std::path::PathBuf;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use srflow_core::{Tolerance, flow_colors, forward_backward_check, score};

use crate::arrays;
use crate::compute::compute;
use crate::errors::exception;

/// Reads a flow file: .flo, KITTI .png, .pfm, .flo5, .npy, .npz or .npz16, detected by its content.
///
/// Returns float32, H x W x 2 in pixels (u to the right, v down); unknown pixels are NaN.
#[pyfunction]
#[pyo3(signature = (path: "str | os.PathLike[str]") -> "NDArray[np.float32]")]
pub fn read_flow(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let flow = compute(py, move || srflow_files::read_flow(&path))?.map_err(exception)?;
    arrays::from_flow(py, flow)
}

/// Writes a flow in the format of the file's extension: .flo, .png (KITTI), .pfm, .flo5, .npy, .npz or .npz16.
///
/// The file appears whole or not at all.
#[pyfunction]
#[pyo3(signature = (path: "str | os.PathLike[str]", flow: "ArrayLike") -> "None")]
pub fn write_flow(py: Python<'_>, path: PathBuf, flow: &Bound<'_, PyAny>) -> PyResult<()> {
    let flow = arrays::flow(flow, "flow")?;
    compute(py, move || srflow_files::write_flow(&path, &flow))?.map_err(exception)
}

/// A flow as a picture in Middlebury's colours: hue is direction, saturation is length, unknown pixels are black.
///
/// `max_flow` is the length in pixels with full saturation; by default that of the longest flow. Returns uint8, H x W x 3.
#[pyfunction]
#[pyo3(signature = (flow: "ArrayLike", max_flow: "float | None" = None) -> "NDArray[np.uint8]")]
pub fn flow_to_rgb<'py>(
    py: Python<'py>,
    flow: &Bound<'py, PyAny>,
    max_flow: Option<f32>,
) -> PyResult<Bound<'py, PyAny>> {
    let flow = arrays::flow(flow, "flow")?;
    if max_flow.is_some_and(|max| !(max > 0.0 && max.is_finite())) {
        return Err(PyValueError::new_err(format!(
            "max_flow: expected a positive number of pixels, found {max_flow:?}"
        )));
    }
    arrays::from_image(py, compute(py, move || flow_colors(&flow, max_flow))?)
}

/// Reconstructs frame 1 from frame 2 by the flow, interpolated bilinearly.
///
/// Returns the image, uint8 H x W x 3, and bool H x W: whether the flow is known and ends inside the frame. Elsewhere the image is
/// black.
#[pyfunction]
#[pyo3(signature = (frame2: "ArrayLike", flow: "ArrayLike") -> "tuple[NDArray[np.uint8], NDArray[np.bool_]]")]
pub fn warp<'py>(
    py: Python<'py>,
    frame2: &Bound<'py, PyAny>,
    flow: &Bound<'py, PyAny>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let (frame2, flow) = (arrays::image(frame2, "frame2")?, arrays::flow(flow, "flow")?);
    let (image, valid) = compute(py, move || srflow_core::warp(&frame2, &flow))?.map_err(exception)?;
    Ok((arrays::from_image(py, image)?, arrays::from_mask(py, valid)?))
}

/// Where following the flow forward and then backward returns to the start: bool, H x W.
///
/// Elsewhere a pixel is hidden in frame 2, leaves it, or one of the flows is wrong. `pixels` is how far from the start it may end;
/// without it the rule is UnFlow's, |f + b|^2 < 0.01 (|f|^2 + |b|^2) + 0.5.
#[pyfunction]
#[pyo3(signature = (
    forward: "ArrayLike",
    backward: "ArrayLike",
    pixels: "float | None" = None
) -> "NDArray[np.bool_]")]
pub fn consistency<'py>(
    py: Python<'py>,
    forward: &Bound<'py, PyAny>,
    backward: &Bound<'py, PyAny>,
    pixels: Option<f32>,
) -> PyResult<Bound<'py, PyAny>> {
    let (forward, backward) = (arrays::flow(forward, "forward")?, arrays::flow(backward, "backward")?);
    let tolerance = pixels.map_or(Tolerance::UNFLOW, |pixels| Tolerance::Absolute { pixels });
    let found = compute(py, move || forward_backward_check(&forward, &backward, tolerance))?;
    arrays::from_mask(py, found.map_err(exception)?)
}

/// Scores a flow over the pixels whose true flow is known and, with a mask (bool, H x W), inside of it.
///
/// Returns a dict: `epe` (mean end-point error, pixels), `px1`, `px3`, `px5` (fractions under so many pixels), `f1_all` (percentage of
/// outliers, over 3 pixels and 5 %), `wauc` (0 to 100) and `valid_pixels`, as ptlflow defines them.
#[pyfunction]
#[pyo3(signature = (
    prediction: "ArrayLike",
    truth: "ArrayLike",
    mask: "ArrayLike | None" = None
) -> "Metrics")]
pub fn metrics<'py>(
    py: Python<'py>,
    prediction: &Bound<'py, PyAny>,
    truth: &Bound<'py, PyAny>,
    mask: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let (prediction, truth) = (arrays::flow(prediction, "prediction")?, arrays::flow(truth, "truth")?);
    let mask = mask.map(|mask| arrays::mask(mask, "mask")).transpose()?;
    let inside = if mask.is_some() { " inside the mask" } else { "" };
    let scores =
        compute(py, move || score(&prediction, &truth, mask.as_ref()))?.map_err(exception)?.ok_or_else(
            || PyValueError::new_err(format!("nothing to score: the truth has no known pixel{inside}")),
        )?;
    let dict = PyDict::new(py);
    for (name, value) in [
        ("epe", scores.epe),
        ("px1", scores.px1),
        ("px3", scores.px3),
        ("px5", scores.px5),
        ("f1_all", scores.f1_all),
        ("wauc", scores.wauc),
    ] {
        dict.set_item(name, value)?;
    }
    dict.set_item("valid_pixels", scores.valid_pixels)?;
    Ok(dict)
}
