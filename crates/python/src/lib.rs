//! The Python package `srflow`: arrays and exceptions around the libraries. Its functions are documented in Python; `srflow/__init__.py`
//! says which are public.

mod arrays;
mod avatar;
mod camera;
mod compute;
mod dataset;
mod errors;
mod face;
mod fields;
mod gaussians;
mod jobs;
mod mer;
mod methods;
mod model;
mod rasterize;

use std::ffi::OsString;

use pyo3::prelude::*;
use srflow_ops::ReusingAllocator;

#[global_allocator]
static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();

/// Runs the command `srflow` with the arguments of a process, of which the first is its name. Returns its exit code.
#[pyfunction]
#[pyo3(signature = (arguments: "list[str]") -> "int")]
fn run(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| srflow_cli::run(arguments))
}

#[pymodule]
mod _srflow {
    #[pymodule_export]
    use super::avatar::Avatar;
    #[pymodule_export]
    use super::camera::Camera;
    #[pymodule_export]
    use super::dataset::Dataset;
    #[pymodule_export]
    use super::face::{FaceFinder, crop_face};
    #[pymodule_export]
    use super::fields::{consistency, flow_to_rgb, metrics, read_flow, warp, write_flow};
    #[pymodule_export]
    use super::gaussians::Gaussians;
    #[pymodule_export]
    use super::jobs::run_job;
    #[pymodule_export]
    use super::methods::{Network, Sequence, flow};
    #[pymodule_export]
    use super::rasterize::{rasterize, rasterize_backward};
    #[pymodule_export]
    use super::run;

    /// See `srflow/mer.py`.
    #[pymodule]
    mod mer {
        #[pymodule_export]
        use crate::mer::{features, loso, metrics, regions, strain};
        #[pymodule_export]
        use crate::model::{Model, load_model};
    }

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        super::ALLOCATOR.survive_forks();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
