//! Estimating flow: between two frames, and along a video.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use srflow::Watch;
use srflow::flow::MethodSpec;
use srflow::settings::from_json;
use srflow_core::{EstimateError, FlowEstimate, FlowEstimator, Image};
use srflow_nets::Architecture;

use crate::arrays;
use crate::compute::{compute, new_threads, wait_for};
use crate::errors::{exception, in_python};
use crate::jobs::from_python;

type Estimator = Arc<dyn FlowEstimator>;

/// The estimator of a method with these options.
pub fn load(
    py: Python<'_>,
    method: Option<String>,
    given: Option<&Bound<'_, PyDict>>,
) -> PyResult<Estimator> {
    let parameters = given.map(from_python).transpose()?.unwrap_or_default();
    let found = compute(py, move || {
        let method = match method {
            Some(method) => method.parse().map_err(srflow::Error::wrong_settings)?,
            None => MethodSpec::default(),
        };
        srflow::flow::estimator(&method, &from_json(&parameters)?, &Watch::SILENT)
    })?;
    Ok(found.map_err(in_python)?.into())
}

fn estimate<'py>(
    estimator: Estimator,
    frame1: &Bound<'py, PyAny>,
    frame2: &Bound<'py, PyAny>,
    initial: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = frame1.py();
    let (frame1, frame2) = (arrays::image(frame1, "frame1")?, arrays::image(frame2, "frame2")?);
    let initial = initial.map(|initial| arrays::flow(initial, "initial")).transpose()?;
    let found = compute(py, move || match initial {
        Some(initial) => estimator.estimate_from(&frame1, &frame2, &initial).map(|estimate| estimate.flow),
        None => estimator.estimate(&frame1, &frame2),
    })?;
    arrays::from_flow(py, found.map_err(exception)?)
}

/// The optical flow from `frame1` to `frame2`.
///
/// Frames are uint8, H x W x 3 (RGB) or H x W (grey). `method` is a name as after `--method` of the command line (`srflow`, `tvl1`,
/// `farneback`, `raft=FILE`, ...); without one, it is srflow's own network. Options are those of `srflow flow --help`: `weights="raft-things.pth"`,
/// `tile="auto"`, `iters=12`, `refine=True`, `device="vulkan"`. `initial` is a flow to start from.
///
/// Returns float32, H x W x 2 in pixels: u to the right, v down, stored at the pixels of `frame1`.
///
/// A network is loaded at each call; for several pairs, load it once with `Network`.
#[pyfunction]
#[pyo3(signature = (
    frame1: "ArrayLike",
    frame2: "ArrayLike",
    method: "str | None" = None,
    *,
    initial: "ArrayLike | None" = None,
    **options: "Any"
) -> "NDArray[np.float32]")]
pub fn flow<'py>(
    py: Python<'py>,
    frame1: &Bound<'py, PyAny>,
    frame2: &Bound<'py, PyAny>,
    method: Option<String>,
    initial: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    estimate(load(py, method, options)?, frame1, frame2, initial)
}

/// A network with its weights, loaded once: `Network("raft", "raft-things.pth", iters=12)(frame1, frame2)`.
///
/// `weights` is a file (PyTorch or safetensors) or the name of published weights; `srflow`, the default, has its own. Other options are
/// those of `flow`.
#[pyclass(module = "srflow", frozen)]
pub struct Network {
    #[pyo3(get)]
    name: String,
    estimator: Estimator,
}

#[pymethods]
impl Network {
    #[new]
    #[pyo3(signature = (
        name: "str" = "srflow",
        weights: "str | os.PathLike[str] | None" = None,
        **options: "Any"
    ) -> "Network")]
    fn new(
        py: Python<'_>,
        name: &str,
        weights: Option<&Bound<'_, PyAny>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let networks = Architecture::ALL.map(Architecture::name);
        if !networks.contains(&name) {
            let networks = networks.join(", ");
            return Err(PyValueError::new_err(format!(
                "`{name}` is no network; the networks are {networks}. Methods without weights: srflow.flow(a, b, method=\"tvl1\")"
            )));
        }
        let given = options.map_or_else(|| Ok(PyDict::new(py)), |options| options.copy())?;
        if let Some(weights) = weights {
            given.set_item("weights", weights)?;
        }
        let estimator = load(py, Some(name.to_owned()), Some(&given))?;
        Ok(Self { name: name.to_owned(), estimator })
    }

    /// The flow from `frame1` to `frame2`, as of `srflow.flow`.
    #[pyo3(signature = (
        frame1: "ArrayLike",
        frame2: "ArrayLike",
        *,
        initial: "ArrayLike | None" = None
    ) -> "NDArray[np.float32]")]
    fn __call__<'py>(
        &self,
        frame1: &Bound<'py, PyAny>,
        frame2: &Bound<'py, PyAny>,
        initial: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        estimate(self.estimator.clone(), frame1, frame2, initial)
    }

    /// Flow along a video, frame by frame; what was computed from a frame is used again for the next pair.
    ///
    /// With `warm_start` a pair starts from the flow of the pair before.
    #[pyo3(signature = (*, warm_start: "bool" = false) -> "Sequence")]
    fn sequence(&self, warm_start: bool) -> PyResult<Sequence> {
        Sequence::new(self.estimator.clone(), warm_start)
    }

    fn __repr__(&self) -> String {
        format!("srflow.Network({:?})", self.name)
    }
}

/// A video, estimated frame by frame; see `Network.sequence`.
#[pyclass(module = "srflow", frozen)]
pub struct Sequence {
    frames: Sender<Image>,
    /// `None` after an interruption: what would come next belongs to the frame whose push was interrupted.
    found: Mutex<Option<Receiver<Found>>>,
}

/// What a frame gives: nothing yet if it is the first.
type Found = Result<Option<FlowEstimate>, EstimateError>;

impl Sequence {
    fn new(estimator: Estimator, warm_start: bool) -> PyResult<Self> {
        let ((frames, next), (sender, found)) = (channel(), channel());
        let threads = new_threads()?;
        // What a sequence remembers stays on one thread.
        std::thread::spawn(move || {
            threads.install(|| {
                let mut sequence = estimator.sequence(warm_start);
                for frame in next {
                    let flow = sequence.push(&[frame]).map(|mut flows| flows.pop());
                    if sender.send(flow).is_err() {
                        return;
                    }
                }
            });
        });
        Ok(Self { frames, found: Some(found).into() })
    }
}

#[pymethods]
impl Sequence {
    /// Adds the next frame. Returns `None` for the first one, then a dict: `flow` from the frame before to this one (float32, H x W x 2)
    /// and, if the network predicts them, `uncertainty` (expected error in pixels) and `occlusion` (probability), float32 H x W;
    /// `iterations` is the number of refinements of a network that refines its flow, which `iters="auto"` leaves to it.
    #[pyo3(signature = (frame: "ArrayLike") -> "Estimate | None")]
    fn push<'py>(&self, frame: &Bound<'py, PyAny>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let py = frame.py();
        let frame = arrays::image(frame, "frame")?;
        let mut place = self.found.try_lock().map_err(|_| {
            PyValueError::new_err(
                "another thread is adding a frame: a sequence takes one frame after another",
            )
        })?;
        let mut found = place.take().ok_or_else(|| {
            PyValueError::new_err("this sequence was interrupted within a frame: begin another one")
        })?;
        _ = self.frames.send(frame); // if the other side has panicked, nothing is received
        let estimate = wait_for(py, &mut found)?;
        *place = Some(found);
        let Some(estimate) = estimate.map_err(exception)? else { return Ok(None) };
        let dict = PyDict::new(py);
        dict.set_item("flow", arrays::from_flow(py, estimate.flow)?)?;
        if let Some(uncertainty) = estimate.uncertainty {
            dict.set_item("uncertainty", arrays::from_plane(py, uncertainty)?)?;
        }
        if let Some(occlusion) = estimate.occlusion {
            dict.set_item("occlusion", arrays::from_plane(py, occlusion)?)?;
        }
        if let Some(iterations) = estimate.iterations {
            dict.set_item("iterations", iterations)?;
        }
        Ok(Some(dict))
    }
}
