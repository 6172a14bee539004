//! Pinhole cameras.

use std::path::PathBuf;

use glam::{DMat4, DVec3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use srflow_core::Size;
use srflow_splat::{CameraError, NamedCamera, Surroundings, read_cameras};

use crate::arrays;
use crate::compute::compute;
use crate::errors::exception;
use crate::gaussians::{Gaussians, none_at_all};

/// A pinhole camera: `Camera(width, height, fx)`.
///
/// Axes are OpenCV's: x right, y down, z forward. Lengths on the image are in pixels, and an integer coordinate is the centre of a pixel.
/// `fx` and `fy` are the focal lengths (`fy` as `fx` by default), `cx` and `cy` the principal point (the centre of the image,
/// `(width - 1) / 2` and `(height - 1) / 2`, by default). `camera_from_world` is a rotation and a translation, float64, 4 x 4; by default
/// the camera is at the origin and looks along +z.
#[pyclass(module = "srflow", frozen)]
pub struct Camera {
    pub inner: srflow_splat::Camera,
    /// The name of its picture in the file that it was read from; empty for others.
    #[pyo3(get)]
    name: String,
    /// Coefficients of the lens distortion in its file, as text, or `None`; they are not rendered.
    #[pyo3(get)]
    distortion: Option<String>,
}

impl Camera {
    /// A camera that can be rendered.
    fn checked(inner: srflow_splat::Camera) -> PyResult<Self> {
        inner.validate().map_err(|error: CameraError| PyValueError::new_err(format!("camera: {error}")))?;
        Ok(Self { inner, name: String::new(), distortion: None })
    }
}

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (
        width: "int",
        height: "int",
        fx: "float",
        fy: "float | None" = None,
        cx: "float | None" = None,
        cy: "float | None" = None,
        camera_from_world: "ArrayLike | None" = None
    ) -> "Camera")]
    fn new(
        width: usize,
        height: usize,
        fx: f64,
        fy: Option<f64>,
        cx: Option<f64>,
        cy: Option<f64>,
        camera_from_world: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let centred = srflow_splat::Camera::centred(Size { width, height }, [fx, fy.unwrap_or(fx)]);
        let pose = match camera_from_world {
            None => DMat4::IDENTITY,
            Some(pose) => {
                let rows = arrays::shaped::<f64>(
                    pose,
                    "camera_from_world",
                    "a rotation and a translation, float64 4 x 4",
                    &[4, 4],
                )?;
                let rows: [f64; 16] = rows.try_into().unwrap_or_default();
                DMat4::from_cols_array(&rows).transpose()
            }
        };
        Self::checked(srflow_splat::Camera {
            cx: cx.unwrap_or(centred.cx),
            cy: cy.unwrap_or(centred.cy),
            camera_from_world: pose,
            ..centred
        })
    }

    /// A camera that shows all of these Gaussians from the front: from +z, where +y is up. Outliers are ignored.
    #[staticmethod]
    #[pyo3(signature = (gaussians: "Gaussians", width: "int" = 800, height: "int" = 800) -> "Camera")]
    fn facing(py: Python<'_>, gaussians: &Gaussians, width: usize, height: usize) -> PyResult<Self> {
        let gaussians = gaussians.inner.clone();
        let seen = compute(py, move || Surroundings::of(&gaussians))?;
        let seen = seen.ok_or_else(|| none_at_all("gaussians"))?;
        Self::checked(srflow_splat::Camera::facing(seen, Size { width, height }))
    }

    /// Reads the cameras of a file, in its order: cameras.json of 3D Gaussian Splatting, transforms.json of NeRF and nerfstudio, a
    /// COLMAP model, and the other formats of `srflow rasterize --help`.
    ///
    /// `size` is (width, height) for formats that do not store it; by default it is that of the pictures that the file lists.
    #[staticmethod]
    #[pyo3(signature = (
        path: "str | os.PathLike[str]",
        size: "tuple[int, int] | None" = None
    ) -> "list[Camera]")]
    fn read(py: Python<'_>, path: PathBuf, size: Option<(usize, usize)>) -> PyResult<Vec<Self>> {
        let size = size.map(|(width, height)| Size { width, height });
        let cameras = compute(py, move || read_cameras(&path, size))?.map_err(exception)?;
        let camera = |NamedCamera { name, camera, distortion }| Self { inner: camera, name, distortion };
        Ok(cameras.into_iter().map(camera).collect())
    }

    /// The same view at another resolution.
    #[pyo3(signature = (width: "int", height: "int") -> "Camera")]
    fn resized(&self, width: usize, height: usize) -> PyResult<Self> {
        let Self { name, distortion, .. } = self;
        let inner = Self::checked(self.inner.resized(Size { width, height }))?.inner;
        Ok(Self { inner, name: name.clone(), distortion: distortion.clone() })
    }

    /// `count` cameras on a circle around `center` (world units), beginning with this one and `degrees / count` apart: to the right where
    /// that is positive.
    #[pyo3(signature = (center: "ArrayLike", degrees: "float", count: "int") -> "list[Camera]")]
    fn orbit(&self, center: &Bound<'_, PyAny>, degrees: f64, count: usize) -> PyResult<Vec<Self>> {
        let center = arrays::vector::<f64, 3>(center, "center", "a point, float64 3")?;
        if !degrees.is_finite() || count > 1_000_000 {
            return Err(PyValueError::new_err(format!(
                "expected a finite number of degrees and at most 1000000 cameras, found {degrees} and {count}"
            )));
        }
        let around = self.inner.orbit(DVec3::from_array(center), degrees, count);
        around.into_iter().map(Self::checked).collect()
    }

    /// Image width in pixels.
    #[getter]
    fn width(&self) -> usize {
        self.inner.width
    }

    /// Image height in pixels.
    #[getter]
    fn height(&self) -> usize {
        self.inner.height
    }

    /// Horizontal focal length in pixels.
    #[getter]
    fn fx(&self) -> f64 {
        self.inner.fx
    }

    /// Vertical focal length in pixels.
    #[getter]
    fn fy(&self) -> f64 {
        self.inner.fy
    }

    /// Column of the principal point in pixels.
    #[getter]
    fn cx(&self) -> f64 {
        self.inner.cx
    }

    /// Row of the principal point in pixels.
    #[getter]
    fn cy(&self) -> f64 {
        self.inner.cy
    }

    /// Rotation and translation, float64, 4 x 4.
    #[getter]
    fn camera_from_world<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let rows = self.inner.camera_from_world.transpose().to_cols_array();
        arrays::new_array(py, rows.to_vec(), &[4, 4])
    }

    /// Where the camera is, float64, 3, world units.
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::new_array(py, self.inner.position().to_array().to_vec(), &[3])
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Pickled<'py>)> {
        let this = slf.get();
        let srflow_splat::Camera { width, height, fx, fy, cx, cy, .. } = this.inner;
        let arguments = (width, height, fx, fy, cx, cy, this.camera_from_world(slf.py())?);
        Ok((slf.get_type().into_any(), arguments))
    }

    fn __repr__(&self) -> String {
        let srflow_splat::Camera { width, height, fx, fy, cx, cy, .. } = self.inner;
        format!("srflow.Camera({width}, {height}, fx={fx}, fy={fy}, cx={cx}, cy={cy})")
    }
}

/// The arguments of `Camera`.
type Pickled<'py> = (usize, usize, f64, f64, f64, f64, Bound<'py, PyAny>);
