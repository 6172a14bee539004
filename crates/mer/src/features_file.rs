//! Features for other programs: one NumPy archive.

use std::path::Path;

use serde::Serialize;
use srflow_data::micro_expression::Clip;
use srflow_eval::MethodRecord;
use srflow_files::{FileError, NpzArray, write_npz};

use crate::apex::ApexRule;
use crate::extract::{FeatureSettings, Preparation};
use crate::features::FEATURE_SIDE;
use crate::run::{DataRecord, FeatureSet};
use crate::sample::Sample;

/// Provenance of features, for [`write_features`].
#[derive(Debug, Clone)]
pub struct FeatureRecipe<'a> {
    /// Names of the classes, by number.
    pub classes: &'a [String],
    pub methods: &'a [MethodRecord],
    /// Preparation of the frames.
    pub preparation: &'a Preparation,
    /// How the apex of clips without one was spotted.
    pub apex: Option<ApexRule>,
}

/// The array `parameters`, as JSON.
#[derive(Serialize)]
struct Parameters<'a> {
    srflow: &'static str,
    /// Labels of the second axis of `X`.
    channels: [&'static str; 3],
    data: &'a [DataRecord],
    methods: &'a [MethodRecord],
    preparation: String,
    face: String,
    resize: &'static str,
    head_motion: &'static str,
    strain: &'static str,
    apex: Option<&'static str>,
}

/// Writes features as an archive that NumPy reads with one `numpy.load`:
///
/// | array | type | shape | content |
/// |---|---|---|---|
/// | `X` | `float32` | (N, 3, 112, 112) | u, v, strain of each clip by each method |
/// | `y` | `int64` | (N,) | class number |
/// | `subject`, `clip`, `dataset`, `method` | text | (N,) | identity of the clip, and flow method |
/// | `onset`, `apex`, `offset` | `int64` | (N,) | numbers of frames |
/// | `apex_spotted` | `int64` | (N,) | 1 where the apex was spotted, 0 where annotated |
/// | `action_units` | text | (N,) | as coded by the dataset |
/// | `head_motion` | `float32` | (N, 5) | what was subtracted: right and down (pixels of 112), degrees clockwise, scale, deviation (pixels of 112); NaN if nothing |
/// | `names` | text | (classes,) | the classes' names, by number |
/// | `parameters` | text | () | provenance, as JSON |
///
/// Clips are in the datasets' order, all of one method before those of the next.
///
/// # Errors
/// When the file cannot be written.
pub fn write_features(path: &Path, set: &FeatureSet, recipe: &FeatureRecipe) -> Result<(), FileError> {
    let samples: Vec<(&str, &Sample)> = set
        .samples
        .iter()
        .flat_map(|(method, samples)| samples.iter().map(move |sample| (method.as_str(), sample)))
        .collect();
    let count = [samples.len()];
    let values: Vec<f32> = samples.iter().flat_map(|(_, s)| s.features.values()).copied().collect();
    let classes: Vec<i64> = samples.iter().map(|(_, sample)| sample.class as i64).collect();
    let text = |of: fn(&Sample) -> &str| samples.iter().map(|(_, sample)| of(sample)).collect::<Vec<_>>();
    let [subjects, clips, datasets] = [text(|s| &s.subject), text(|s| &s.clip), text(|s| &s.dataset)];
    let methods: Vec<&str> = samples.iter().map(|(method, _)| *method).collect();
    let names: Vec<&str> = recipe.classes.iter().map(String::as_str).collect();
    let repeated = || set.samples.iter().flat_map(|_| &set.clips);
    let numbers = |of: fn(&Clip) -> u64| -> Vec<i64> { repeated().map(|clip| of(clip) as i64).collect() };
    let onsets = numbers(|clip| clip.annotation.onset);
    let apexes = numbers(|clip| clip.annotation.apex.unwrap_or(clip.annotation.onset));
    let offsets = numbers(|clip| clip.annotation.offset);
    let spotted: Vec<i64> =
        set.samples.iter().flat_map(|_| &set.apex_spotted).map(|spotted| i64::from(*spotted)).collect();
    let units: Vec<&str> = repeated().map(|clip| clip.annotation.action_units.as_str()).collect();
    let moved = |sample: &Sample| sample.head_motion.map_or([f64::NAN; 5], |motion| motion.values());
    let moved: Vec<f32> = samples.iter().flat_map(|(_, s)| moved(s)).map(|value| value as f32).collect();
    let Preparation { face, features: FeatureSettings { resize, head_motion, strain } } = recipe.preparation;
    let parameters = Parameters {
        srflow: env!("CARGO_PKG_VERSION"),
        channels: ["u", "v", "strain"],
        data: &set.data,
        methods: recipe.methods,
        preparation: recipe.preparation.to_string(),
        face: face.to_string(),
        resize: resize.name(),
        head_motion: head_motion.name(),
        strain: strain.name(),
        apex: recipe.apex.map(ApexRule::name),
    };
    let parameters = serde_json::to_string(&parameters).expect("numbers and text");
    write_npz(
        path,
        &[
            ("X", NpzArray::Float(&[samples.len(), 3, FEATURE_SIDE, FEATURE_SIDE], &values)),
            ("y", NpzArray::Integer(&count, &classes)),
            ("subject", NpzArray::Text(&count, &subjects)),
            ("clip", NpzArray::Text(&count, &clips)),
            ("dataset", NpzArray::Text(&count, &datasets)),
            ("method", NpzArray::Text(&count, &methods)),
            ("onset", NpzArray::Integer(&count, &onsets)),
            ("apex", NpzArray::Integer(&count, &apexes)),
            ("offset", NpzArray::Integer(&count, &offsets)),
            ("apex_spotted", NpzArray::Integer(&count, &spotted)),
            ("action_units", NpzArray::Text(&count, &units)),
            ("head_motion", NpzArray::Float(&[samples.len(), 5], &moved)),
            ("names", NpzArray::Text(&[names.len()], &names)),
            ("parameters", NpzArray::Text(&[], &[&parameters])),
        ],
    )
}
