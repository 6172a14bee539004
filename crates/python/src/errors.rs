//! Errors as exceptions, with the sentences of the command line.

use std::io;

use pyo3::PyErr;
use pyo3::exceptions::PyValueError;
use srflow_avatar::AvatarError;
use srflow_face::FaceError;
use srflow_field::{FileError, FileProblem};
use srflow_read::flow::DatasetError;

/// `OSError` or one of its classes where the operating system refused something, else `ValueError`.
pub fn exception(error: impl Into<anyhow::Error>) -> PyErr {
    let error = error.into();
    let text = srflow::in_words(&error);
    match error.chain().find_map(kind) {
        Some(kind) => io::Error::new(kind, text).into(),
        None => PyValueError::new_err(text),
    }
}

fn kind(cause: &(dyn std::error::Error + 'static)) -> Option<io::ErrorKind> {
    if let Some(error) = cause.downcast_ref::<io::Error>() {
        return Some(error.kind());
    }
    if let Some(DatasetError::File(error)) = cause.downcast_ref() {
        return kind(error);
    }
    if let Some(AvatarError::Read(error) | AvatarError::IctFolder(error)) = cause.downcast_ref() {
        return kind(error);
    }
    if let Some(FaceError::File(error)) = cause.downcast_ref() {
        return kind(error);
    }
    if let Some(DatasetError::NotThere { .. }) = cause.downcast_ref() {
        return Some(io::ErrorKind::NotFound);
    }
    match &cause.downcast_ref::<FileError>()?.problem {
        FileProblem::Io { error, .. } | FileProblem::Place { error, .. } => Some(error.kind()),
        FileProblem::Field { .. } | FileProblem::Pixel { .. } => None,
    }
}
