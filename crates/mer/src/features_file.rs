//! Features for other programs: one NumPy archive.

use std::path::Path;

use serde::Serialize;
use srflow_data::micro_expression::Clip;
use srflow_eval::MethodRecord;
use srflow_face::FaceError;
use srflow_files::{FileError, NpzArray, write_npz};

use crate::apex::ApexRule;
use crate::extract::{FeatureSettings, Preparation};
use crate::face::FaceCrop;
use crate::features::FEATURE_SIDE;
use crate::regions::{RegionFlow, Regions};
use crate::run::{DataRecord, FeatureSet};
use crate::sample::Sample;
use crate::spotting::{ACTION_UNITS, region_motion_of_features, unit_motion};

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
    /// How faces are divided into the regions whose motion is written, too.
    pub regions: Option<Regions>,
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
    regions: Option<&'static str>,
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
/// With regions, also:
///
/// | array | type | shape | content |
/// |---|---|---|---|
/// | `region_names` | text | (R,) | names of the regions |
/// | `region_map` | `int64` | (N, 112, 112) | number of the region of each pixel, from 1; 0 outside |
/// | `regions` | `float32` | (N, R, 5) | mean u and v, mean strain, main directional mean u and v; NaN for a region without pixels |
/// | `unit_numbers` | `int64` | (A,) | action units of FACS |
/// | `units` | `float32` | (N, A) | how far the face moves as each does ([`unit_motion`]), pixels of 112 |
///
/// Clips are in the datasets' order, all of one method before those of the next.
///
/// # Errors
/// When landmarks are missing, or the file cannot be written.
pub fn write_features(path: &Path, set: &FeatureSet, recipe: &FeatureRecipe) -> Result<(), FeatureFileError> {
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
        regions: recipe.regions.map(Regions::name),
    };
    let parameters = serde_json::to_string(&parameters).expect("numbers and text");
    let parameters = [parameters.as_str()];
    let (maps, motions, named) =
        ([samples.len(), 3, FEATURE_SIDE, FEATURE_SIDE], [samples.len(), 5], [names.len()]);
    let mut arrays = vec![
        ("X", NpzArray::Float(&maps, &values)),
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
        ("head_motion", NpzArray::Float(&motions, &moved)),
        ("names", NpzArray::Text(&named, &names)),
        ("parameters", NpzArray::Text(&[], &parameters)),
    ];
    let regions = recipe.regions.map(|regions| OfRegions::of(set, regions, face)).transpose()?;
    arrays.extend(regions.iter().flat_map(OfRegions::arrays));
    Ok(write_npz(path, &arrays)?)
}

/// The motion of regions and action units, in the order of the samples: arrays and their shapes.
struct OfRegions {
    names: ([usize; 1], Vec<&'static str>),
    maps: ([usize; 3], Vec<i64>),
    flow: ([usize; 3], Vec<f32>),
    numbers: ([usize; 1], Vec<i64>),
    units: ([usize; 2], Vec<f32>),
}

impl OfRegions {
    fn of(set: &FeatureSet, regions: Regions, face: &FaceCrop) -> Result<Self, FaceError> {
        let of_clip = |clip: &Clip| {
            let points = face.points_of_clip(&clip.dataset, &clip.annotation)?;
            Ok((regions.map(&points), points))
        };
        let faces = set.clips.iter().map(of_clip).collect::<Result<Vec<_>, FaceError>>()?;
        let unknown = RegionFlow { mean: [f32::NAN; 2], strain: f32::NAN, main: [f32::NAN; 2] };
        let (mut maps, mut flow, mut units) = (Vec::new(), Vec::new(), Vec::new());
        for (sample, (map, points)) in set.samples.iter().flat_map(|(_, samples)| samples.iter().zip(&faces))
        {
            maps.extend(map.labels().iter().map(|label| i64::from(*label)));
            for of_region in map.flow(&sample.features) {
                let RegionFlow { mean: [u, v], strain, main } = of_region.unwrap_or(unknown);
                flow.extend([u, v, strain, main[0], main[1]]);
            }
            let motion = region_motion_of_features(points, &sample.features);
            units.extend(unit_motion(&motion).map(|moved| moved as f32));
        }
        let (count, names) = (set.samples.len() * faces.len(), regions.names());
        Ok(Self {
            maps: ([count, FEATURE_SIDE, FEATURE_SIDE], maps),
            flow: ([count, names.len(), 5], flow),
            names: ([names.len()], names),
            numbers: ([ACTION_UNITS.len()], ACTION_UNITS.map(i64::from).into()),
            units: ([count, ACTION_UNITS.len()], units),
        })
    }

    fn arrays(&self) -> [(&'static str, NpzArray<'_>); 5] {
        [
            ("region_names", NpzArray::Text(&self.names.0, &self.names.1)),
            ("region_map", NpzArray::Integer(&self.maps.0, &self.maps.1)),
            ("regions", NpzArray::Float(&self.flow.0, &self.flow.1)),
            ("unit_numbers", NpzArray::Integer(&self.numbers.0, &self.numbers.1)),
            ("units", NpzArray::Float(&self.units.0, &self.units.1)),
        ]
    }
}

/// Why features could not be written.
#[derive(Debug, thiserror::Error)]
pub enum FeatureFileError {
    /// A clip has no landmarks.
    #[error(transparent)]
    Face(#[from] FaceError),
    /// The file could not be written.
    #[error(transparent)]
    File(#[from] FileError),
}
