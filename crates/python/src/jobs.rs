//! Jobs: work that takes long, with progress and a way to stop.

use std::sync::Mutex;

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Map, Value};
use srflow::{Done, Entry, Watch};

use crate::compute::{Reporter, compute_reporting};
use crate::errors::in_python;

/// Runs the job of this name with these settings; see `srflow/jobs.py`. Returns the report, its text and what the job found wrong.
/// What lasts until it is stopped, such as a page that is served, begins once the text is printed, and ends with Ctrl-C.
#[pyfunction]
#[pyo3(signature = (
    name: "str",
    settings: "dict[str, Any]",
    callback: "Callable[[dict[str, Any]], object] | None" = None
) -> "tuple[dict[str, Any], str, str | None]")]
pub fn run_job<'py>(
    py: Python<'py>,
    name: &str,
    settings: &Bound<'py, PyDict>,
    callback: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, String, Option<String>)> {
    let entry =
        Entry::named(name).ok_or_else(|| PyValueError::new_err(format!("no job is called {name:?}")))?;
    let settings = from_python(settings)?;
    check_callback(callback)?;
    let on_event = |progress: Value| match callback {
        Some(callback) => callback.call1((to_python(py, &progress)?,)).map(drop),
        None => Ok(()),
    };
    let done = compute_reporting(py, on_event, move |reporter: &Reporter<Value>| {
        let last = Mutex::new(Value::Null);
        let on_progress = |progress: &srflow::Progress| {
            let Ok(progress) = serde_json::to_value(progress) else { return };
            // A message alone is for people who look at a bar.
            let Ok(mut last) = last.lock() else { return };
            if *last != progress {
                last.clone_from(&progress);
                drop(last);
                reporter.report(progress);
            }
        };
        entry.run(settings, &Watch { on_progress: &on_progress, stop: &|| reporter.stops() })
    })?;
    let Done { report, text, failure, follow_up } = done.map_err(in_python)?;
    if let Some(follow_up) = follow_up {
        py.import("builtins")?.call_method1("print", (text.trim_end(),))?;
        let ended = compute_reporting(py, |()| Ok(()), |reporter| follow_up(&|| reporter.stops()))?;
        ended.map_err(in_python)?;
    }
    Ok((to_python(py, &report)?, text, failure))
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

/// Keyword arguments as JSON. Paths and other objects are their text; `None` is a setting that is not given.
pub fn from_python(keywords: &Bound<'_, PyDict>) -> PyResult<Map<String, Value>> {
    let py = keywords.py();
    let options = PyDict::new(py);
    options.set_item("default", py.import("builtins")?.getattr("str")?)?;
    let text: String = py.import("json")?.call_method("dumps", (keywords,), Some(&options))?.extract()?;
    let settings: Map<String, Value> =
        serde_json::from_str(&text).map_err(|error| PyValueError::new_err(format!("settings: {error}")))?;
    Ok(settings.into_iter().filter(|(_, value)| !value.is_null()).collect())
}

/// Dicts, lists, numbers and text.
pub fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}
