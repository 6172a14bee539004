//! Images, flow and masks from and to numpy's arrays.

use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use srflow_field::{FlowField, Image, Mask, Plane};

/// An array, an object with `__array__` (a tensor, a Pillow image, lists), or one with `__dlpack__`.
fn array<'py>(object: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyUntypedArray>> {
    if let Ok(array) = object.cast::<PyUntypedArray>() {
        return Ok(array.clone());
    }
    let by_dlpack = object.hasattr("__dlpack__")? && !object.hasattr("__array__")?;
    let from = if by_dlpack { "from_dlpack" } else { "asarray" };
    Ok(object.py().import("numpy")?.call_method1(from, (object,))?.cast_into()?)
}

/// The elements, row-major.
fn elements<T: Element + Copy>(array: &Bound<'_, PyUntypedArray>) -> Option<Vec<T>> {
    let array = array.cast::<PyArrayDyn<T>>().ok()?.readonly();
    let view = array.as_array();
    Some(view.as_slice().map_or_else(|| view.iter().copied().collect(), <[T]>::to_vec))
}

fn wrong(name: &str, expected: &str, array: &Bound<'_, PyUntypedArray>) -> PyErr {
    let shape = array.shape().iter().map(ToString::to_string).collect::<Vec<_>>().join(" x ");
    PyValueError::new_err(format!("{name}: expected {expected}, found {} {shape}", array.dtype()))
}

/// `H x W x 3` uint8, or `H x W` for grey.
pub fn image(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Image> {
    let array = array(object)?;
    let error = || wrong(name, "an image, uint8 H x W x 3 (RGB) or H x W (grey)", &array);
    let values: Vec<u8> = elements(&array).ok_or_else(error)?;
    let (&[height, width] | &[height, width, 3]) = array.shape() else { return Err(error()) };
    let pixels = match array.ndim() {
        2 => values.into_iter().map(|grey| [grey; 3]).collect(),
        _ => values.as_chunks().0.to_vec(),
    };
    Image::from_pixels(width, height, pixels)
        .ok()
        .filter(|image| !image.pixels().is_empty())
        .ok_or_else(error)
}

/// `H x W x 2`, floating point; a pixel with a component that is not finite is unknown.
pub fn flow(object: &Bound<'_, PyAny>, name: &str) -> PyResult<FlowField> {
    let array = array(object)?;
    let error = || wrong(name, "a flow, float32 H x W x 2 (u to the right, v down, pixels)", &array);
    if array.dtype().kind() != b'f' {
        return Err(error());
    }
    let single = array.call_method1("astype", ("float32",))?.cast_into::<PyUntypedArray>()?;
    let values: Vec<f32> = elements(&single).ok_or_else(error)?;
    let &[height, width, 2] = array.shape() else { return Err(error()) };
    let known = |flow: &[f32; 2]| if flow.iter().all(|x| x.is_finite()) { *flow } else { [f32::NAN; 2] };
    let pixels = values.as_chunks().0.iter().map(known).collect();
    FlowField::from_pixels(width, height, pixels)
        .ok()
        .filter(|flow| !flow.pixels().is_empty())
        .ok_or_else(error)
}

/// `H x W` bool.
pub fn mask(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Mask> {
    let array = array(object)?;
    let error = || wrong(name, "a mask, bool H x W (of a picture: picture > 127)", &array);
    let values: Vec<bool> = elements(&array).ok_or_else(error)?;
    let &[height, width] = array.shape() else { return Err(error()) };
    Mask::from_pixels(width, height, values).map_err(|_| error())
}

/// Rows of pixels of so many numbers each.
fn new_array<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

pub fn from_image(py: Python<'_>, image: Image) -> PyResult<Bound<'_, PyAny>> {
    let (width, height) = image.size();
    new_array(py, image.into_pixels().into_flattened(), &[height, width, 3])
}

pub fn from_flow(py: Python<'_>, flow: FlowField) -> PyResult<Bound<'_, PyAny>> {
    let (width, height) = flow.size();
    new_array(py, flow.into_pixels().into_flattened(), &[height, width, 2])
}

pub fn from_plane(py: Python<'_>, plane: Plane) -> PyResult<Bound<'_, PyAny>> {
    let (width, height) = plane.size();
    new_array(py, plane.into_pixels(), &[height, width])
}

pub fn from_mask(py: Python<'_>, mask: Mask) -> PyResult<Bound<'_, PyAny>> {
    let (width, height) = mask.size();
    new_array(py, mask.into_pixels(), &[height, width])
}
