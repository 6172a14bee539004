//! Work that takes long: rendering datasets and training networks, with progress and a way to stop.

use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;
use srflow::Watch;

use crate::compute::{Reporter, compute_reporting};
use crate::errors::exception;
use crate::options::{options, with_path};

/// Renders a facial optical-flow dataset with exact flow into the folder `out`.
///
/// Options are those of `srflow render --help`, with underscores: `render("tiny", scenes=3, frames=8, size="550x802")`.
///
/// `callback` is called with progress: a dict with `done` and `total` (pairs) and `bytes` (written so far). When it raises an exception, or on
/// Ctrl-C, rendering stops after the pairs in progress, and the exception is raised; the same call continues.
///
/// Returns a dict, as the command prints with `--json`: `pairs`, `made`, `bytes`, `seconds`, `stopped`, `statistics`, ...
#[pyfunction]
#[pyo3(signature = (
    out: "str | os.PathLike[str]",
    *,
    callback: "Callable[[dict[str, int]], object] | None" = None,
    **options: "Any"
) -> "dict[str, Any]")]
pub fn render<'py>(
    py: Python<'py>,
    out: PathBuf,
    callback: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let arguments = [with_path("out", &out)];
    run(py, arguments.into(), options, callback, srflow::render)
}

/// Trains an optical flow network: `train("cpu-small", "runs/first", data="srflow:DIR")`.
///
/// `config` is a preset or a TOML file, `out` the folder of the run. Options are those of `srflow train --help`, with underscores;
/// `set={"training.clip": 0.5}` reaches every key of the configuration, and `train(resume="runs/first")` continues a run.
///
/// `callback` is called with progress: a dict with `done` and `total` (steps) and `event`, which is "started", "step" (with `loss`, `epe`,
/// `learning_rate`, ...), "skipped", "validation" (with `dataset`, `whole`, ...) or "saved" (with `path`). When it raises an exception, or on
/// Ctrl-C, training stops after the step in progress with a checkpoint, from which `resume` continues, and the exception is raised.
///
/// Returns a dict, as the command prints with `--json`: `run`, `steps`, `stopped`, `best`, `weights` (a file for `Network`), ... With
/// `print_config=True` nothing is trained, and it is the configuration.
#[pyfunction]
#[pyo3(signature = (
    config: "str | os.PathLike[str] | None" = None,
    out: "str | os.PathLike[str] | None" = None,
    *,
    callback: "Callable[[dict[str, Any]], object] | None" = None,
    **options: "Any"
) -> "dict[str, Any]")]
pub fn train<'py>(
    py: Python<'py>,
    config: Option<PathBuf>,
    out: Option<PathBuf>,
    callback: Option<&Bound<'py, PyAny>>,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let given = [("config", config), ("out", out)];
    let arguments = given.into_iter().filter_map(|(name, path)| Some(with_path(name, &path?)));
    run(py, arguments.collect(), options, callback, srflow::train)
}

type Command = fn(Vec<OsString>, &Watch) -> anyhow::Result<Value>;

fn run<'py>(
    py: Python<'py>,
    mut arguments: Vec<OsString>,
    given: Option<&Bound<'py, PyDict>>,
    callback: Option<&Bound<'py, PyAny>>,
    command: Command,
) -> PyResult<Bound<'py, PyAny>> {
    arguments.extend(options(given)?);
    check_callback(callback)?;
    let on_event = |progress: Value| match callback {
        Some(callback) => callback.call1((to_python(py, &progress)?,)).map(drop),
        None => Ok(()),
    };
    let found = compute_reporting(py, on_event, move |reporter: &Reporter<Value>| {
        let on_progress = |progress| reporter.report(progress);
        command(arguments, &Watch { on_progress: &on_progress, stop: &|| reporter.stops() })
    })?;
    to_python(py, &found.map_err(exception)?)
}

/// Refuses what cannot be called before the work: it would end it at its first report.
pub fn check_callback(callback: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
    match callback {
        Some(callback) if !callback.is_callable() => {
            let found = callback.get_type().name()?;
            Err(PyTypeError::new_err(format!("callback: expected a function, found {found}")))
        }
        _ => Ok(()),
    }
}

/// Dicts, lists, numbers and text.
pub fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}
