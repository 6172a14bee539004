//! Options of the command line as keywords.

use std::ffi::OsString;
use std::path::Path;

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyList, PyTuple};

/// The options of the command line: `tile="auto"` is `--tile=auto`, `refine=True` is `--refine`.
pub fn options(given: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<OsString>> {
    let mut options: Vec<String> = Vec::new();
    for (name, value) in given.into_iter().flatten() {
        let name = name.to_string().replace('_', "-");
        if let Ok(settings) = value.cast::<PyDict>() {
            for (key, value) in settings {
                options.push(format!("--{name}={key}={}", text(&value)));
            }
        } else if let Ok(flag) = value.cast::<PyBool>() {
            options.extend(flag.is_true().then(|| format!("--{name}")));
        } else if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
            for value in value.try_iter()? {
                options.push(format!("--{name}={}", text(&value?)));
            }
        } else if !value.is_none() {
            options.push(format!("--{name}={}", text(&value)));
        }
    }
    Ok(options.into_iter().map(OsString::from).collect())
}

/// `--name=path`, for a path of any bytes.
pub fn with_path(name: &str, path: &Path) -> OsString {
    let mut option = OsString::from(format!("--{name}="));
    option.push(path);
    option
}

/// A value as the command line has it: truth values as in TOML.
fn text(value: &Bound<'_, PyAny>) -> String {
    match value.cast::<PyBool>() {
        Ok(flag) => flag.is_true().to_string(),
        Err(_) => value.to_string(),
    }
}
