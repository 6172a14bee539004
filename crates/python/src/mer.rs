//! Recognizing micro-expressions.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use pyo3::exceptions::{PyKeyError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use srflow_face::AVERAGE_FACE;
use srflow_mer::{
    CLASSIFIERS, ClassifierEntry, FeatureSettings, Features, Fold, FoldFolder, LabelledClip, LeftOut, Loso,
    LosoError, LosoEvent, LosoWatch, Outcome, Prediction, Protocol, RecognitionProtocol, Regions, Sample,
    StrainFormula, Summary, features_of_frames, leave_one_subject_out_by, leave_out, optical_strain,
};

use crate::arrays;
use crate::compute::{compute, compute_reporting};
use crate::errors::exception;
use crate::jobs::{check_callback, to_python};
use crate::methods::load;

/// More classes than anybody divides expressions into: larger numbers are no classes.
const MAX_CLASSES: usize = 1000;

fn named<T: std::str::FromStr<Err = String>>(name: &str, value: &str) -> PyResult<T> {
    value.parse().map_err(|error| PyValueError::new_err(format!("{name}: {error}")))
}

/// What classifiers see of a clip: the flow from its onset to its apex at 112 x 112, and the optical strain.
///
/// Frames are uint8, H x W x 3 (RGB) or H x W, of one size. `method` and the options are those of `srflow.flow`. `protocol` is "srflow" or
/// "paper"; where given, `resize` says whether the frames are resized "before" the flow is estimated, or the flow "after", and
/// `head_motion` whether to "keep" the head's motion or to "subtract" it. `strain` is the formula, "literature" or "off-tanet".
///
/// Returns float32, 3 x 112 x 112: u, v (pixels of 112 x 112) and strain, as `srflow mer features` writes them.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
#[pyo3(signature = (
    onset: "ArrayLike",
    apex: "ArrayLike",
    method: "str | None" = None,
    *,
    protocol: "str" = "srflow",
    resize: "str | None" = None,
    head_motion: "str | None" = None,
    strain: "str" = "literature",
    **options: "Any"
) -> "NDArray[np.float32]")]
pub fn features<'py>(
    py: Python<'py>,
    onset: &Bound<'py, PyAny>,
    apex: &Bound<'py, PyAny>,
    method: Option<String>,
    protocol: &str,
    resize: Option<&str>,
    head_motion: Option<&str>,
    strain: &str,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (onset, apex) = (arrays::image(onset, "onset")?, arrays::image(apex, "apex")?);
    let sizes = [onset.size(), apex.size()];
    if sizes[0] != sizes[1] {
        return Err(PyValueError::new_err(format!(
            "the frames differ in size: the onset is {}, the apex {}",
            sizes[0], sizes[1]
        )));
    }
    let protocol = named::<RecognitionProtocol>("protocol", protocol)?.features();
    let settings = FeatureSettings {
        resize: resize.map_or(Ok(protocol.resize), |resize| named("resize", resize))?,
        head_motion: head_motion.map_or(Ok(protocol.head_motion), |what| named("head_motion", what))?,
        strain: named("strain", strain)?,
    };
    let estimator = load(py, method, options)?;
    let found = compute(py, move || features_of_frames(&onset, &apex, &*estimator, settings))?;
    let (features, _) = found.map_err(exception)?;
    arrays::new_array(py, features.values().to_vec(), &[3, 112, 112])
}

/// Regions of interest of a face in the maps of `features`: their names and a map, int64, 112 x 112, of their numbers from 1; 0 is outside.
///
/// `which` is "parts" (brows, eyes, cheeks and so on) or "mdmo" (the 36 of MDMO). `landmarks` are dlib's 68 points, float64, 68 x 2, as shares of
/// the sides of the crop that the features are of; by default those of an average face.
#[pyfunction]
#[pyo3(signature = (
    which: "str" = "parts",
    landmarks: "ArrayLike | None" = None
) -> "tuple[list[str], NDArray[np.int64]]")]
pub fn regions<'py>(
    py: Python<'py>,
    which: &str,
    landmarks: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Vec<&'static str>, Bound<'py, PyAny>)> {
    let which: Regions = named("which", which)?;
    let mut points = AVERAGE_FACE;
    if let Some(landmarks) = landmarks {
        let values = arrays::shaped::<f64>(landmarks, "landmarks", "points, float64 68 x 2", &[68, 2])?;
        points.as_flattened_mut().copy_from_slice(&values);
    }
    let labels = which.map(&points).labels().iter().map(|label| i64::from(*label)).collect();
    Ok((which.names(), arrays::new_array::<i64>(py, labels, &[112, 112])?))
}

/// Optical strain of a flow: how much it stretches and shears the skin.
///
/// `formula` is "literature", sqrt(ux^2 + vy^2 + (uy + vx)^2 / 2) with derivatives per pixel, or "off-tanet", what the code of that network
/// computes. Returns float32, H x W; NaN beside unknown pixels of the flow.
#[pyfunction]
#[pyo3(signature = (flow: "ArrayLike", formula: "str" = "literature") -> "NDArray[np.float32]")]
pub fn strain<'py>(py: Python<'py>, flow: &Bound<'py, PyAny>, formula: &str) -> PyResult<Bound<'py, PyAny>> {
    let flow = arrays::flow(flow, "flow")?;
    let formula: StrainFormula = named("formula", formula)?;
    arrays::from_plane(py, compute(py, move || optical_strain(&flow, formula))?)
}

/// The metrics of the SRFlow paper's tables, and those of MEGC 2019, of predictions for every clip.
///
/// `truth` and `predicted` are numbers of classes from 0, N; `subjects` are N names or numbers, which are the folds. `classes` is the number of
/// classes, by default up to the largest number found.
///
/// Returns a dict: `p_m`, `r_m`, `f1_m`, `f1_mu` and `g_m` (precision, recall and F1, macro-averaged over the classes of a fold; accuracy;
/// geometric mean of recalls; each the mean over folds), `uf1` and `uar` (unweighted F1 and recall over all classes, of all folds pooled), and
/// `confusion`, int64, true x predicted.
#[pyfunction]
#[pyo3(signature = (
    truth: "ArrayLike",
    predicted: "ArrayLike",
    subjects: "Iterable[object]",
    *,
    classes: "int | None" = None
) -> "Scores")]
pub fn metrics<'py>(
    py: Python<'py>,
    truth: &Bound<'py, PyAny>,
    predicted: &Bound<'py, PyAny>,
    subjects: &Bound<'py, PyAny>,
    classes: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    const NUMBERS: &str = "numbers of classes from 0, int64 N";
    let truth = arrays::indices(truth, "truth", NUMBERS, None)?;
    let expected = format!("numbers of classes from 0, int64 {}", truth.len());
    let predicted = arrays::indices(predicted, "predicted", &expected, Some(truth.len()))?;
    let subjects = texts(subjects, "subjects", truth.len())?;
    let classes = class_names(truth.iter().chain(&predicted), classes)?;
    let prediction = |(index, subject): (usize, String)| Prediction {
        dataset: String::new(),
        subject,
        clip: index.to_string(),
        truth: truth[index],
        seed: 0,
        epoch: 0,
        predicted: predicted[index],
        scores: Vec::new(),
    };
    let predictions: Vec<Prediction> = subjects.into_iter().enumerate().map(prediction).collect();
    let summary = Summary::of(&classes, &predictions).map_err(exception)?;
    let scores = summary.last();
    let dict = PyDict::new(py);
    for (name, value) in ["p_m", "r_m", "f1_m", "f1_mu", "g_m"].into_iter().zip(scores.mean.values()) {
        dict.set_item(name, value)?;
    }
    dict.set_item("uf1", scores.uf1())?;
    dict.set_item("uar", scores.uar())?;
    let counts: Vec<i64> = scores.counts().0.iter().flatten().map(|count| *count as i64).collect();
    dict.set_item("confusion", arrays::new_array(py, counts, &[classes.len(), classes.len()])?)?;
    Ok(dict)
}

/// Text of each of `count` items.
fn texts(object: &Bound<'_, PyAny>, name: &str, count: usize) -> PyResult<Vec<String>> {
    let items = object.try_iter()?.map(|item| Ok(item?.to_string()));
    let items = items.collect::<PyResult<Vec<String>>>()?;
    if items.len() == count {
        return Ok(items);
    }
    Err(PyValueError::new_err(format!("{name}: expected {count} names, found {}", items.len())))
}

/// The names of the classes, which are their numbers, where only their number is known.
fn class_names<'a>(found: impl Iterator<Item = &'a usize>, wanted: Option<usize>) -> PyResult<Arc<[String]>> {
    let least = found.max().map_or(0, |largest| largest.saturating_add(1));
    let classes = wanted.unwrap_or(least);
    if !(least..=MAX_CLASSES).contains(&classes) {
        return Err(PyValueError::new_err(format!(
            "classes: expected a number of classes from {least} (the largest number of a class and 1) to {MAX_CLASSES}, found {classes}"
        )));
    }
    Ok((0..classes).map(|class| class.to_string()).collect())
}

/// Clips as `srflow mer features` writes them, without their features.
struct Clips {
    dataset: Vec<String>,
    subject: Vec<String>,
    clip: Vec<String>,
    class: Vec<usize>,
    classes: Arc<[String]>,
}

impl Clips {
    fn of(features: &Bound<'_, PyAny>) -> PyResult<Self> {
        let class =
            arrays::indices(&needed(features, "y")?, "y", "numbers of classes from 0, int64 N", None)?;
        let count = class.len();
        let of = |key: &str| column(features, key)?.map(|found| texts(&found, key, count)).transpose();
        let classes = match column(features, "names")? {
            None => class_names(class.iter(), None)?,
            Some(names) => {
                let names: Vec<String> =
                    names.try_iter()?.map(|name| Ok(name?.to_string())).collect::<PyResult<_>>()?;
                class_names(class.iter(), Some(names.len()))?;
                names.into()
            }
        };
        Ok(Self {
            subject: texts(&needed(features, "subject")?, "subject", count)?,
            dataset: of("dataset")?.unwrap_or_else(|| vec!["clips".to_owned(); count]),
            clip: of("clip")?.unwrap_or_else(|| (0..count).map(|index| index.to_string()).collect()),
            class,
            classes,
        })
    }

    fn labelled(&self) -> Vec<LabelledClip<'_>> {
        let clip = |index: usize| LabelledClip {
            dataset: &self.dataset[index],
            subject: &self.subject[index],
            clip: &self.clip[index],
            class: self.class[index],
        };
        (0..self.class.len()).map(clip).collect()
    }

    /// As the built-in classifiers take them.
    fn samples(&self, inputs: &Bound<'_, PyAny>) -> PyResult<Vec<Sample>> {
        let count = self.class.len();
        let expected = format!("features, float32 {count} x 3 x 112 x 112");
        let values = arrays::shaped::<f32>(inputs, "X", &expected, &[count, 3, 112, 112])?;
        let features =
            values.chunks_exact(Features::LEN).map(|values| Features::from_values(values.to_vec()));
        let sample = |(index, features): (usize, Result<Features, _>)| {
            Ok(Sample {
                dataset: self.dataset[index].clone(),
                subject: self.subject[index].clone(),
                clip: self.clip[index].clone(),
                class: self.class[index],
                features: features.map_err(exception)?,
                head_motion: None,
            })
        };
        features.enumerate().map(sample).collect()
    }

    /// Work of a run: clips that a classifier is trained on, over all folds and epochs.
    fn clip_epochs(&self, epochs: usize) -> usize {
        let mut subjects: Vec<[&str; 2]> =
            self.labelled().iter().map(|clip| [clip.dataset, clip.subject]).collect();
        subjects.sort_unstable();
        subjects.dedup();
        // Each clip is used once for each other subject.
        self.class.len().saturating_mul(subjects.len().saturating_sub(1)).saturating_mul(epochs)
    }

    /// The numbers of results.json, the names of the classes, and the last predictions in the order of the clips.
    fn results<'py>(&self, py: Python<'py>, loso: &Loso) -> PyResult<Bound<'py, PyDict>> {
        let outcome = Outcome::of("", "", loso).map_err(exception)?;
        let mut record = serde_json::to_value(outcome.record()).map_err(exception)?;
        if let Some(record) = record.as_object_mut() {
            record.remove("method");
            record.remove("set");
        }
        let last = outcome.summary.last().epoch;
        let places: HashMap<[&str; 3], usize> = self.labelled().iter().map(name).zip(0..).collect();
        let mut predicted = vec![0_i64; self.class.len()];
        let seed = outcome.summary.seeds[0];
        let of_last = |prediction: &&Prediction| prediction.epoch == last && prediction.seed == seed;
        for prediction in loso.predictions.iter().filter(of_last) {
            let Prediction { dataset, subject, clip, predicted: class, .. } = prediction;
            if let Some(&place) = places.get(&[dataset.as_str(), subject, clip]) {
                predicted[place] = *class as i64;
            }
        }
        let results: Bound<'py, PyDict> = to_python(py, &record)?.cast_into()?;
        results.set_item("classes", self.classes.to_vec())?;
        let count = [predicted.len()];
        results.set_item("predictions", arrays::new_array(py, predicted, &count)?)?;
        Ok(results)
    }
}

fn name<'a>(clip: &LabelledClip<'a>) -> [&'a str; 3] {
    [clip.dataset, clip.subject, clip.clip]
}

/// An entry of a dict or an archive of numpy.
fn column<'py>(features: &Bound<'py, PyAny>, key: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
    match features.get_item(key) {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.is_instance_of::<PyKeyError>(features.py()) => Ok(None),
        Err(error) => Err(error),
    }
}

fn needed<'py>(features: &Bound<'py, PyAny>, key: &str) -> PyResult<Bound<'py, PyAny>> {
    column(features, key)?.ok_or_else(|| {
        PyValueError::new_err(format!(
            "features: expected `X`, `y` and `subject`, as in an archive of `srflow mer features`; there is no `{key}`"
        ))
    })
}

/// The training of the built-in classifiers, where it is not the paper's.
struct Training {
    folder: Option<PathBuf>,
    epochs: Option<usize>,
    record_every: Option<usize>,
    batch: Option<usize>,
    learning_rate: Option<f64>,
    seed: Option<u64>,
    seeds: Option<usize>,
}

impl Training {
    fn protocol(&self) -> Protocol {
        let paper = Protocol::default();
        Protocol {
            epochs: self.epochs.unwrap_or(paper.epochs),
            record_every: self.record_every.unwrap_or(paper.record_every),
            batch: self.batch.unwrap_or(paper.batch),
            learning_rate: self.learning_rate.unwrap_or(paper.learning_rate),
            seed: self.seed.unwrap_or(paper.seed),
            seeds: self.seeds.unwrap_or(paper.seeds),
            ..paper
        }
    }

    /// The first option that was given.
    fn given(&self) -> Option<&'static str> {
        let given = [
            ("folder", self.folder.is_some()),
            ("epochs", self.epochs.is_some()),
            ("record_every", self.record_every.is_some()),
            ("batch", self.batch.is_some()),
            ("learning_rate", self.learning_rate.is_some()),
            ("seed", self.seed.is_some()),
            ("seeds", self.seeds.is_some()),
        ];
        given.into_iter().find_map(|(name, given)| given.then_some(name))
    }
}

/// Leave one subject out: each subject's clips are classified by a classifier that was trained on those of all others.
///
/// `features` is an archive of `srflow mer features`, opened by `numpy.load`, or a dict with its keys: `X`, `y` (numbers of classes, N),
/// `subject` (names, N) and, if there are, `clip`, `dataset` (names, N) and `names` (of the classes). The archive is of one flow method.
///
/// `classifier` is a function `(train_inputs, train_labels, test_inputs) -> predictions` that is called for each subject with rows of `X` and
/// `y` and returns numbers of classes; `X` then holds anything, one row per clip. Or it is the name of a built-in classifier,
/// "linear" (default), "off-tanet", "sssnet", "ststnet" or "off-apexnet", for `X` of float32, N x 3 x 112 x 112; `epochs`, `record_every`, `batch`,
/// `learning_rate`, `seed` and `seeds` are then those of `srflow mer run` (the paper's by default, for networks alone), and finished subjects are kept in `folder`, from
/// which the same call continues.
///
/// `callback` is called with progress, a dict with `done` and `total`; when it raises an exception, the run stops.
///
/// Returns a dict: `last`, the scores after the last epoch (those of `metrics`); `best`, each of the paper's metrics at its best epoch;
/// `epochs`; `baseline`; `folds`; `classes`, and `predictions`, int64, N, after the last epoch in the order of the clips
/// (of the first seed).
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
#[pyo3(signature = (
    features: "Mapping[str, Any]",
    classifier: "Callable[[NDArray[Any], NDArray[np.int64], NDArray[Any]], ArrayLike] | str | None" = None,
    *,
    callback: "Callable[[dict[str, int]], object] | None" = None,
    folder: "str | os.PathLike[str] | None" = None,
    epochs: "int | None" = None,
    record_every: "int | None" = None,
    batch: "int | None" = None,
    learning_rate: "float | None" = None,
    seed: "int | None" = None,
    seeds: "int | None" = None
) -> "Results")]
pub fn loso<'py>(
    py: Python<'py>,
    features: &Bound<'py, PyAny>,
    classifier: Option<&Bound<'py, PyAny>>,
    callback: Option<&Bound<'py, PyAny>>,
    folder: Option<PathBuf>,
    epochs: Option<usize>,
    record_every: Option<usize>,
    batch: Option<usize>,
    learning_rate: Option<f64>,
    seed: Option<u64>,
    seeds: Option<usize>,
) -> PyResult<Bound<'py, PyDict>> {
    let training = Training { folder, epochs, record_every, batch, learning_rate, seed, seeds };
    check_callback(callback)?;
    let clips = Clips::of(features)?;
    let inputs = needed(features, "X")?;
    let tell = |done: usize, total: usize| match callback {
        Some(callback) => {
            callback.call1((to_python(py, &serde_json::json!({ "done": done, "total": total }))?,)).map(drop)
        }
        None => Ok(()),
    };
    let loso = match classifier {
        Some(function) if function.is_callable() => {
            if let Some(option) = training.given() {
                return Err(PyValueError::new_err(format!(
                    "{option} is for the built-in classifiers: leave it out with a function"
                )));
            }
            by_function(&clips, &inputs, function, tell)?
        }
        classifier => built_in(&clips, &inputs, classifier, &training, tell)?,
    };
    clips.results(py, &loso)
}

/// An error of the library, or of the function.
enum Failed {
    Loso(LosoError),
    Python(PyErr),
}

impl From<LosoError> for Failed {
    fn from(error: LosoError) -> Self {
        Self::Loso(error)
    }
}

impl From<PyErr> for Failed {
    fn from(error: PyErr) -> Self {
        Self::Python(error)
    }
}

fn by_function<'py>(
    clips: &Clips,
    inputs: &Bound<'py, PyAny>,
    function: &Bound<'py, PyAny>,
    tell: impl Fn(usize, usize) -> PyResult<()>,
) -> PyResult<Loso> {
    let py = inputs.py();
    let inputs = py.import("numpy")?.call_method1("asarray", (inputs,))?;
    let rows = inputs.len()?;
    if rows != clips.class.len() {
        return Err(PyValueError::new_err(format!(
            "X: expected a row for each of {} clips, found {rows}",
            clips.class.len()
        )));
    }
    let (mut done, total) = (0, clips.clip_epochs(1));
    let classify = |fold: &Fold| {
        let of = |clips: &[usize]| {
            let clips: Vec<i64> = clips.iter().map(|&clip| clip as i64).collect();
            let count = [clips.len()];
            inputs.get_item(arrays::new_array(py, clips, &count)?)
        };
        let labels = fold.training.iter().map(|&clip| clips.class[clip] as i64).collect();
        let labels = arrays::new_array::<i64>(py, labels, &[fold.training.len()])?;
        let found = function.call1((of(&fold.training)?, labels, of(&fold.tested)?))?;
        let tested = fold.tested.len();
        let what = format!("predictions for subject {}", fold.subject.as_deref().unwrap_or_default());
        let expected = format!("numbers of classes from 0, int64 {tested}");
        let found = arrays::indices(&found, &what, &expected, Some(tested))?;
        done += fold.training.len();
        tell(done, total)?;
        Ok::<_, Failed>(found)
    };
    leave_one_subject_out_by(&clips.labelled(), &clips.classes, classify).map_err(|failed| match failed {
        Failed::Loso(error) => exception(error),
        Failed::Python(error) => error,
    })
}

fn built_in<'py>(
    clips: &Clips,
    inputs: &Bound<'py, PyAny>,
    classifier: Option<&Bound<'py, PyAny>>,
    training: &Training,
    tell: impl Fn(usize, usize) -> PyResult<()>,
) -> PyResult<Loso> {
    let py = inputs.py();
    let entry = match classifier {
        None => &ClassifierEntry::LINEAR,
        Some(name) => {
            let names = CLASSIFIERS.each_ref().map(|entry| entry.facts.name).join(", ");
            if !name.is_instance_of::<PyString>() {
                let found = name.get_type().name()?;
                return Err(PyTypeError::new_err(format!(
                    "classifier: expected a function or one of {names}, found {found}"
                )));
            }
            ClassifierEntry::from_name(&name.to_string()).ok_or_else(|| {
                PyValueError::new_err(format!(
                    "classifier: expected a function or one of {names}, found `{name}`"
                ))
            })?
        }
    };
    let protocol = training.protocol();
    let epochs = entry.epochs(&protocol);
    let (mut done, total) = (0_usize, clips.clip_epochs(epochs).saturating_mul(protocol.seeds));
    let on_event = |event| {
        match event {
            LosoEvent::Epoch { clips } => done += clips,
            LosoEvent::Fold { clips, resumed: true } => done += clips * epochs,
            LosoEvent::Fold { resumed: false, .. } => return Ok(()),
        }
        tell(done, total)
    };
    let (samples, classes, folder) = (clips.samples(inputs)?, clips.classes.clone(), training.folder.clone());
    let found = compute_reporting(py, on_event, move |reporter| {
        let (on_event, stop) = (|event| reporter.report(event), || reporter.stops());
        let folder = folder.as_deref().map(FoldFolder::from);
        let watch = LosoWatch { on_event: &on_event, stop: &stop };
        leave_out(LeftOut::EachSubject, entry, &samples, &classes, &protocol, folder, watch)
    })?;
    found.map_err(exception)
}
