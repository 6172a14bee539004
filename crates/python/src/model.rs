//! Trained classifiers of micro-expressions.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use srflow_mer::{FEATURE_SIDE, Features, LEAST_PROBABILITY, RecognitionModel};

use crate::arrays;
use crate::compute::compute;
use crate::errors::exception;
use crate::jobs::to_python;

/// A trained classifier of micro-expressions; see `load_model`.
///
/// Call it with the features of a clip, float32 3 x 112 x 112, as `features` gives them. It returns a dict: `probabilities` by class,
/// `class`, or None if the model does not know, `most_probable`, and `doubt`, which says why it does not know. `face_px` is the width of the face
/// in pixels, by default large enough. A class is named if its probability is at least `least_probability`.
#[pyclass(module = "srflow.mer", frozen)]
pub struct Model {
    model: Arc<RecognitionModel>,
}

#[pymethods]
impl Model {
    /// The names of the classes.
    #[getter]
    fn classes(&self) -> Vec<String> {
        self.model.card.classes.clone()
    }

    /// What is known about the model: its training data, how right it is, its flow method and features.
    #[pyo3(signature = () -> "dict[str, Any]")]
    fn card<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let card = serde_json::to_value(&self.model.card).expect("a card is plain data");
        to_python(py, &card)
    }

    #[pyo3(signature = (
        features: "ArrayLike",
        /,
        *,
        face_px: "int | None" = None,
        least_probability: "float" = 0.5
    ) -> "Recognition")]
    fn __call__<'py>(
        &self,
        py: Python<'py>,
        features: &Bound<'py, PyAny>,
        face_px: Option<usize>,
        least_probability: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        const _: () = assert!(LEAST_PROBABILITY == 0.5);
        const EXPECTED: &str = "features of a clip, float32 3 x 112 x 112";
        let values = arrays::shaped(features, "features", EXPECTED, &[3, FEATURE_SIDE, FEATURE_SIDE])?;
        let features = Features::from_values(values)
            .map_err(|error| PyValueError::new_err(format!("features: {error}")))?;
        let model = self.model.clone();
        let face_px = face_px.unwrap_or(usize::MAX);
        let recognition = compute(py, move || model.recognize(&features, face_px, least_probability))?;
        let classes = &self.model.card.classes;
        let probabilities = PyDict::new(py);
        for (class, probability) in classes.iter().zip(recognition.probabilities) {
            probabilities.set_item(class, probability)?;
        }
        let most_probable = &classes[recognition.class];
        let found = PyDict::new(py);
        found.set_item("probabilities", probabilities)?;
        found.set_item("class", recognition.doubt.is_none().then_some(most_probable))?;
        found.set_item("most_probable", most_probable)?;
        found.set_item("doubt", recognition.doubt.map(|doubt| doubt.to_string()))?;
        Ok(found)
    }
}

/// Loads a trained classifier: a folder that `srflow mer run` saved. "rendered", the default, comes with srflow and has learned from rendered
/// clips alone.
#[pyfunction]
#[pyo3(signature = (model: "str | os.PathLike[str] | None" = None) -> "Model")]
pub fn load_model(py: Python<'_>, model: Option<PathBuf>) -> PyResult<Model> {
    let model = model.unwrap_or_else(|| srflow::mer::predict::RENDERED.into());
    let model = compute(py, move || srflow::mer::predict::open_model(&model))?;
    Ok(Model { model: Arc::new(model.map_err(exception)?) })
}
