//! Datasets of flow.

use std::sync::Arc;

use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use srflow_data::flow::{DatasetSpec, FlowDataset, Split};

use crate::arrays;
use crate::compute::compute;
use crate::errors::exception;

/// The pairs of a dataset: `Dataset("spring:/data/spring", split="train")`. Pairs are read when they are asked for.
///
/// The kinds are those of `srflow eval --help`; `split` is "train", "val", "test" or "all", by default the one that results are
/// reported on. It works as a dataset of PyTorch's `DataLoader` as it stands, with workers by fork and by spawn.
///
/// A pair is a dict: `id`, `frame1` and `frame2` (uint8, H x W x 3) and, where the dataset has them, `flow` (float32, H x W x 2, NaN where
/// unknown), `valid` (bool, H x W: whether the flow is known), `mask` (bool: on the head) and `occlusion` (bool: hidden in frame 2).
#[pyclass(module = "srflow", frozen)]
pub struct Dataset {
    /// `KIND:DIR`.
    spec: String,
    dataset: Arc<FlowDataset>,
}

#[pymethods]
impl Dataset {
    #[new]
    #[pyo3(signature = (spec: "str", split: "str | None" = None) -> "Dataset")]
    fn new(py: Python<'_>, spec: String, split: Option<&str>) -> PyResult<Self> {
        let parsed: DatasetSpec = spec.parse().map_err(exception)?;
        let split: Option<Split> = split
            .map(|split| split.parse().map_err(|error| PyValueError::new_err(format!("split: {error}"))))
            .transpose()?;
        let dataset = compute(py, move || FlowDataset::open(&parsed, split))?.map_err(exception)?;
        Ok(Self { spec, dataset: Arc::new(dataset) })
    }

    fn __len__(&self) -> usize {
        self.dataset.entries().len()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, index: isize) -> PyResult<Bound<'py, PyDict>> {
        let len = self.dataset.entries().len();
        let at = if index < 0 { index.saturating_add_unsigned(len) } else { index };
        let Some(at) = usize::try_from(at).ok().filter(|at| *at < len) else {
            return Err(PyIndexError::new_err(format!("pair {index} of {len}")));
        };
        let dataset = self.dataset.clone();
        let sample = compute(py, move || dataset.read(&dataset.entries()[at]))?.map_err(exception)?;
        let pair = PyDict::new(py);
        pair.set_item("id", self.dataset.entries()[at].id())?;
        pair.set_item("frame1", arrays::from_image(py, sample.frame1)?)?;
        pair.set_item("frame2", arrays::from_image(py, sample.frame2)?)?;
        if let Some(flow) = sample.flow {
            pair.set_item("valid", arrays::from_mask(py, flow.known())?)?;
            pair.set_item("flow", arrays::from_flow(py, flow)?)?;
        }
        for (name, mask) in [("mask", sample.mask), ("occlusion", sample.occlusion)] {
            if let Some(mask) = mask {
                pair.set_item(name, arrays::from_mask(py, mask)?)?;
            }
        }
        Ok(pair)
    }

    /// Names of all pairs, in order: SCENE/FRAME, or FRAME.
    #[getter]
    fn ids(&self) -> Vec<String> {
        self.dataset.entries().iter().map(|entry| entry.id()).collect()
    }

    /// The part of the dataset that was opened.
    #[getter]
    fn split(&self) -> String {
        self.dataset.split().to_string()
    }

    /// For workers that are started by spawn.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (String, String)) {
        let this = slf.get();
        (slf.get_type().into_any(), (this.spec.clone(), this.split()))
    }

    fn __repr__(&self) -> String {
        format!("srflow.Dataset({:?}, split={:?})  # {} pairs", self.spec, self.split(), self.__len__())
    }
}
