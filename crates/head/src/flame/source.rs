use std::path::Path;

use srflow_files::{Array, FileError, FileProblem, Npz};

use crate::pickled_arrays::{Matrix, PickledArrays};

/// A file of named arrays.
pub(super) enum Source {
    Npz(Npz),
    Pickle(PickledArrays),
}

impl Source {
    /// An archive of NumPy by the extension `.npz`, else a pickle.
    pub(super) fn open(path: &Path) -> Result<Self, FileError> {
        let is_npz = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz"));
        Ok(if is_npz { Self::Npz(Npz::open(path)?) } else { Self::Pickle(PickledArrays::open(path)?) })
    }

    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Npz(file) => file.path(),
            Self::Pickle(file) => file.path(),
        }
    }

    pub(super) fn array(&mut self, name: &str) -> Result<Array, FileError> {
        match self {
            Self::Npz(file) => file.array(name),
            Self::Pickle(file) => file.array(name),
        }
    }

    /// A matrix, which is dense in archives of NumPy.
    pub(super) fn matrix(&mut self, name: &str) -> Result<Matrix, FileError> {
        match self {
            Self::Npz(file) => {
                let array = file.array(name)?;
                let wrong = |problem: FileProblem| problem.in_file(file.path());
                Matrix::dense(&array).map_err(wrong)
            }
            Self::Pickle(file) => file.matrix(name),
        }
    }
}
