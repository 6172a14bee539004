//! Errors as exceptions, with the sentences of the command line.

use std::error::Error;
use std::io;

use pyo3::PyErr;
use pyo3::exceptions::PyValueError;
use srflow_data::flow::DatasetError;
use srflow_nets::PublishedError;

/// `OSError` or one of its classes where the operating system refused something, else `ValueError`.
pub fn exception(error: impl Into<anyhow::Error>) -> PyErr {
    let error = error.into();
    let text = srflow::error::in_words(&error);
    match error.chain().find_map(kind) {
        Some(kind) => io::Error::new(kind, text).into(),
        None => PyValueError::new_err(text),
    }
}

/// The error, with a wrong setting as a keyword.
pub fn in_python(error: srflow::Error) -> PyErr {
    match error.setting() {
        Some(setting) => PyValueError::new_err(format!(
            "{}={}: expected {}",
            setting.name(),
            setting.found,
            setting.expected
        )),
        None => exception(error),
    }
}

fn kind(cause: &(dyn Error + 'static)) -> Option<io::ErrorKind> {
    let dataset = matches!(cause.downcast_ref(), Some(DatasetError::NotThere { .. }));
    let weights = matches!(cause.downcast_ref(), Some(PublishedError::Unknown { .. }));
    if dataset || weights {
        return Some(io::ErrorKind::NotFound);
    }
    cause.downcast_ref::<io::Error>().map(io::Error::kind)
}
