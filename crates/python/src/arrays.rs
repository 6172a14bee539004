//! Images, flow, masks and lists of numbers from and to numpy's arrays.

use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray,
    PyUntypedArrayMethods, dtype,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use srflow_core::{FlowField, Image, Mask, Plane, Size};

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

/// The shape and the elements, row-major, converted to `T` from any type of `kinds`, as numpy names them.
fn converted<T: Element + Copy>(
    object: &Bound<'_, PyAny>,
    name: &str,
    expected: &str,
    kinds: &[u8],
) -> PyResult<(Vec<usize>, Vec<T>)> {
    let array = array(object)?;
    let error = || wrong(name, expected, &array);
    let values = match elements(&array) {
        Some(values) => values,
        None if kinds.contains(&array.dtype().kind()) => {
            let same = array.call_method1("astype", (dtype::<T>(object.py()),))?.cast_into()?;
            elements(&same).ok_or_else(error)?
        }
        None => return Err(error()),
    };
    Ok((array.shape().to_vec(), values))
}

/// What was found of an array with this shape, for messages about its shape.
fn mismatch(object: &Bound<'_, PyAny>, name: &str, expected: &str) -> PyErr {
    array(object).map_or_else(|error| error, |array| wrong(name, expected, &array))
}

/// Real numbers of any shape, in double or single precision, and their shape; `expected` says which.
pub fn numbers<T: Element + Copy>(
    object: &Bound<'_, PyAny>,
    name: &str,
    expected: &str,
) -> PyResult<(Vec<usize>, Vec<T>)> {
    converted(object, name, expected, b"fiu")
}

/// Real numbers, `count x N`.
pub fn rows<T: Element + Copy, const N: usize>(
    object: &Bound<'_, PyAny>,
    name: &str,
    expected: &str,
) -> PyResult<Vec<[T; N]>> {
    let (shape, values) = numbers(object, name, expected)?;
    match shape[..] {
        [_, width] if width == N => Ok(values.as_chunks().0.to_vec()),
        _ => Err(mismatch(object, name, expected)),
    }
}

/// `N` real numbers.
pub fn vector<T: Element + Copy, const N: usize>(
    object: &Bound<'_, PyAny>,
    name: &str,
    expected: &str,
) -> PyResult<[T; N]> {
    let (shape, values) = numbers(object, name, expected)?;
    let same = if shape.len() == 1 { values.try_into().ok() } else { None };
    same.ok_or_else(|| mismatch(object, name, expected))
}

/// Real numbers of this shape.
pub fn shaped<T: Element + Copy>(
    object: &Bound<'_, PyAny>,
    name: &str,
    expected: &str,
    shape: &[usize],
) -> PyResult<Vec<T>> {
    let (found, values) = numbers(object, name, expected)?;
    if found == shape { Ok(values) } else { Err(mismatch(object, name, expected)) }
}

/// Whole numbers from 0, one for each of `count` things where that is known.
pub fn indices(
    object: &Bound<'_, PyAny>,
    name: &str,
    expected: &str,
    count: Option<usize>,
) -> PyResult<Vec<usize>> {
    let (shape, values) = converted::<i64>(object, name, expected, b"iu")?;
    let fits = shape.len() == 1 && count.is_none_or(|count| count == values.len());
    let found = values.into_iter().map(|value| usize::try_from(value).ok()).collect::<Option<Vec<_>>>();
    found.filter(|_| fits).ok_or_else(|| mismatch(object, name, expected))
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
    let expected = "a flow, float32 H x W x 2 (u to the right, v down, pixels)";
    let error = || mismatch(object, name, expected);
    let (shape, values) = converted::<f32>(object, name, expected, b"f")?;
    let [height, width, 2] = shape[..] else { return Err(error()) };
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

/// An array that owns these values, row-major.
pub fn new_array<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

pub fn from_image(py: Python<'_>, image: Image) -> PyResult<Bound<'_, PyAny>> {
    let Size { width, height } = image.size();
    new_array(py, image.into_pixels().into_flattened(), &[height, width, 3])
}

pub fn from_flow(py: Python<'_>, flow: FlowField) -> PyResult<Bound<'_, PyAny>> {
    let Size { width, height } = flow.size();
    new_array(py, flow.into_pixels().into_flattened(), &[height, width, 2])
}

pub fn from_plane(py: Python<'_>, plane: Plane) -> PyResult<Bound<'_, PyAny>> {
    let Size { width, height } = plane.size();
    new_array(py, plane.into_pixels(), &[height, width])
}

pub fn from_mask(py: Python<'_>, mask: Mask) -> PyResult<Bound<'_, PyAny>> {
    let Size { width, height } = mask.size();
    new_array(py, mask.into_pixels(), &[height, width])
}
