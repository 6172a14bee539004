//! Sets of 3D Gaussians.

use std::path::PathBuf;
use std::sync::Arc;

use glam::{Quat, Vec3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use srflow_splat::{read_gaussians, write_gaussians};

use crate::arrays;
use crate::compute::compute;
use crate::errors::exception;

/// 3D Gaussians, one row of each array per Gaussian.
///
/// Values are activated, as they are rendered: `scales` are standard deviations (not logarithms), `opacities` are from 0 to 1 (not logits).
///
/// - `means`: centres, float32, N x 3, world units.
/// - `scales`: standard deviations along the rotated axes, float32, N x 3, world units.
/// - `rotations`: world from Gaussian, quaternions x, y, z, w (3DGS and gsplat have w first), float32, N x 4; rendering normalizes them.
/// - `opacities`: opacity at the centre, float32, N.
/// - `sh`: coefficients of the spherical harmonics, float32, N x K x 3 (R, G, B), K = 1, 4, 9 or 16 for degree 0 to 3. The colour is
///   max(0, 0.5 + sum of coefficient times basis), so a constant colour c is `(c - 0.5) / 0.28209479` in N x 1 x 3.
/// - `antialiased`: whether a Gaussian smaller than a pixel loses opacity instead of growing; they look right only as they were trained.
///
/// The arrays of a `Gaussians` are copies: changing them does not change it.
#[pyclass(module = "srflow", frozen)]
pub struct Gaussians {
    pub inner: Arc<srflow_splat::Gaussians>,
}

impl From<srflow_splat::Gaussians> for Gaussians {
    fn from(gaussians: srflow_splat::Gaussians) -> Self {
        Self { inner: Arc::new(gaussians) }
    }
}

/// The degree of spherical harmonics with so many coefficients.
fn degree(coefficients: usize) -> Option<usize> {
    (0..=3).find(|degree| (degree + 1) * (degree + 1) == coefficients)
}

#[pymethods]
impl Gaussians {
    #[new]
    #[pyo3(signature = (
        means: "ArrayLike",
        scales: "ArrayLike",
        rotations: "ArrayLike",
        opacities: "ArrayLike",
        sh: "ArrayLike",
        antialiased: "bool" = false
    ) -> "Gaussians")]
    fn new(
        means: &Bound<'_, PyAny>,
        scales: &Bound<'_, PyAny>,
        rotations: &Bound<'_, PyAny>,
        opacities: &Bound<'_, PyAny>,
        sh: &Bound<'_, PyAny>,
        antialiased: bool,
    ) -> PyResult<Self> {
        let means = arrays::rows::<f32, 3>(means, "means", "centres, float32 N x 3")?;
        let n = means.len();
        let scales = arrays::shaped::<f32>(scales, "scales", &format!("lengths, float32 {n} x 3"), &[n, 3])?;
        let expected = format!("quaternions x, y, z, w, float32 {n} x 4");
        let rotations = arrays::shaped::<f32>(rotations, "rotations", &expected, &[n, 4])?;
        let expected = format!("numbers from 0 to 1, float32 {n}");
        let opacities = arrays::shaped::<f32>(opacities, "opacities", &expected, &[n])?;
        let expected = format!("spherical harmonics, float32 {n} x K x 3 with K = 1, 4, 9 or 16");
        let (shape, _) = arrays::numbers::<f32>(sh, "sh", &expected)?;
        let coefficients = shape.get(1).copied().unwrap_or_default();
        // Of another number of coefficients, the shape below is another one too.
        let sh_degree = degree(coefficients).unwrap_or_default();
        let sh_len = (sh_degree + 1) * (sh_degree + 1);
        let sh = arrays::shaped::<f32>(sh, "sh", &expected, &[n, sh_len, 3])?;
        let vectors = |values: &[f32]| values.as_chunks().0.iter().copied().map(Vec3::from_array).collect();
        Ok(srflow_splat::Gaussians {
            positions: means.into_iter().map(Vec3::from_array).collect(),
            scales: vectors(&scales),
            rotations: rotations.as_chunks().0.iter().copied().map(Quat::from_array).collect(),
            opacities,
            sh_degree,
            sh: sh.as_chunks().0.to_vec(),
            antialiased,
        }
        .into())
    }

    /// Reads a file of 3D Gaussians by its extension, in the coordinates of the file: .ply of 3D Gaussian Splatting, .splat, .spz, .glb, .ksplat or .sog.
    #[staticmethod]
    #[pyo3(signature = (path: "str | os.PathLike[str]") -> "Gaussians")]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(compute(py, move || read_gaussians(&path))?.map_err(exception)?.into())
    }

    /// Writes a file of 3D Gaussians by its extension: .ply of 3D Gaussian Splatting, .splat, .spz or .glb. Of these, .ply and .glb keep every
    /// value. The file appears whole or not at all.
    #[pyo3(signature = (path: "str | os.PathLike[str]") -> "None")]
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let gaussians = self.inner.clone();
        compute(py, move || write_gaussians(&path, &gaussians))?.map_err(exception)
    }

    /// Centers, float32, N x 3.
    #[getter]
    fn means<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        vectors(py, &self.inner.positions)
    }

    /// Standard deviations along the axes, float32, N x 3.
    #[getter]
    fn scales<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        vectors(py, &self.inner.scales)
    }

    /// Quaternions x, y, z, w, float32, N x 4.
    #[getter]
    fn rotations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let values = self.inner.rotations.iter().flat_map(|rotation| rotation.to_array()).collect();
        arrays::new_array::<f32>(py, values, &[self.inner.len(), 4])
    }

    /// From 0 to 1, float32, N.
    #[getter]
    fn opacities<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::new_array(py, self.inner.opacities.clone(), &[self.inner.len()])
    }

    /// Spherical harmonics, float32, N x coefficients x 3.
    #[getter]
    fn sh<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let shape = [self.inner.len(), self.inner.sh_len(), 3];
        arrays::new_array(py, self.inner.sh.as_flattened().to_vec(), &shape)
    }

    /// Whether they were made for antialiased rasterizing.
    #[getter]
    fn antialiased(&self) -> bool {
        self.inner.antialiased
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Pickled<'py>)> {
        let (py, this) = (slf.py(), slf.get());
        let arrays = (
            this.means(py)?,
            this.scales(py)?,
            this.rotations(py)?,
            this.opacities(py)?,
            this.sh(py)?,
            this.antialiased(),
        );
        Ok((slf.get_type().into_any(), arrays))
    }

    fn __repr__(&self) -> String {
        format!("srflow.Gaussians({}, sh_degree={})", self.inner.len(), self.inner.sh_degree)
    }
}

/// The arguments of `Gaussians`.
type Pickled<'py> =
    (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>, bool);

/// An array of `N x 3`.
pub fn vectors<'py>(py: Python<'py>, vectors: &[Vec3]) -> PyResult<Bound<'py, PyAny>> {
    let values = vectors.iter().flat_map(|vector| vector.to_array()).collect();
    arrays::new_array::<f32>(py, values, &[vectors.len(), 3])
}

/// The error of a set without Gaussians, where there must be some.
pub fn none_at_all(name: &str) -> PyErr {
    PyValueError::new_err(format!("{name}: expected at least one Gaussian, found none"))
}
