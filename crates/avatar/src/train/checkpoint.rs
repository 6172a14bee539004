//! The state of a training in a file, from which it goes on exactly: a NumPy archive (`.npz`) with the lists of numbers that Adam and
//! the density control keep, the configuration and a fingerprint of the capture. No random state needs saving: every random number
//! derives from the seed and the iteration.

use std::path::Path;

use glam::{Quat, Vec3};
use serde_json::{Map, Value};
use srflow_core::excerpt;
use srflow_files::{FileError, FileProblem, Npz, NpzArray, parse_error_in_words, write_npz};
use srflow_splat::Gaussians;

use super::TrainConfig;
use crate::BoundGaussians;

/// Lists of numbers by name.
pub(super) type Lists = Vec<(&'static str, Vec<f32>)>;

/// Text: the configuration as JSON, and the fingerprint of the capture.
const TRAINING: &str = "training";
const ITERATION: &str = "iteration";
const TRIANGLES: &str = "triangles";
const POSITIONS: &str = "positions";
const SCALES: &str = "scales";
const ROTATIONS: &str = "rotations";
const OPACITIES: &str = "opacities";
const SH: &str = "sh";
/// All integers up to this one are exact in `f32`.
const MOST_EXACT: f32 = 16_777_216.0;

/// The lists of [`Checkpoint::gaussians`].
pub(super) fn lists_of(bound: &BoundGaussians) -> Lists {
    let Gaussians { positions, scales, rotations, opacities, sh, .. } = bound.local();
    vec![
        (TRIANGLES, bound.triangles().iter().map(|&triangle| triangle as f32).collect()),
        (POSITIONS, bytemuck::cast_slice(positions).to_vec()),
        (SCALES, bytemuck::cast_slice(scales).to_vec()),
        (ROTATIONS, bytemuck::cast_slice(rotations).to_vec()),
        (OPACITIES, opacities.clone()),
        (SH, sh.as_flattened().to_vec()),
    ]
}

/// Writes the state after `iteration`, whole or not at all.
pub(super) fn write(
    path: &Path,
    config: &TrainConfig,
    fingerprint: &str,
    iteration: u64,
    lists: &Lists,
) -> Result<(), FileError> {
    let config = serde_json::to_string(config).expect("numbers and text");
    let iteration = [i64::try_from(iteration).unwrap_or(i64::MAX)];
    let texts = [config.as_str(), fingerprint];
    let mut arrays =
        vec![(TRAINING, NpzArray::Text(&[2], &texts)), (ITERATION, NpzArray::Integer(&[], &iteration))];
    let shapes: Vec<[usize; 1]> = lists.iter().map(|(_, list)| [list.len()]).collect();
    for ((name, list), shape) in lists.iter().zip(&shapes) {
        arrays.push((name, NpzArray::Float(shape, list)));
    }
    write_npz(path, &arrays)
}

/// A checkpoint that is being read.
pub(super) struct Checkpoint {
    npz: Npz,
    pub iteration: u64,
}

impl Checkpoint {
    /// Opens the checkpoint of a training with this configuration, on the capture of this fingerprint, or of the `older` one that
    /// checkpoints had before.
    ///
    /// # Errors
    /// When it cannot be read, is damaged, or is that of another training.
    pub fn open(
        path: &Path,
        config: &TrainConfig,
        fingerprint: &str,
        older: impl FnOnce() -> String,
    ) -> Result<Self, FileError> {
        let mut npz = Npz::open(path)?;
        let texts = npz.texts(TRAINING)?;
        let [of_config, of_capture] = &texts[..] else {
            let expected = "the configuration and the fingerprint of the capture";
            return Err(
                FileProblem::field(TRAINING, expected, format!("{} texts", texts.len())).in_file(path)
            );
        };
        let of_config: TrainConfig = serde_json::from_str(of_config).map_err(|error| {
            let found = parse_error_in_words(&error);
            FileProblem::field("configuration", "one that this version knows", found).in_file(path)
        })?;
        if let Some((key, before, now)) = changed(String::new(), &in_json(&of_config), &in_json(config)) {
            let expected = format!("the one of the checkpoint, in which {key} is {before}");
            let found = format!("{now}; go on with the same configuration, or start again in another folder");
            return Err(FileProblem::field("configuration", expected, found).in_file(path));
        }
        if of_capture != fingerprint && *of_capture != older() {
            let found = format!(
                "one with the fingerprint {fingerprint}; its pictures, cameras or parameters of the head have changed. Go on \
                 with the same files, or start again in another folder"
            );
            let expected = format!("the capture with the fingerprint {}", excerpt(of_capture));
            return Err(FileProblem::field("capture", expected, found).in_file(path));
        }
        let mut checkpoint = Self { npz, iteration: 0 };
        checkpoint.iteration = checkpoint.counts(ITERATION, Some(1))?[0].into();
        Ok(checkpoint)
    }

    /// The list of this name, of `len` numbers if that is known.
    ///
    /// # Errors
    /// When there is none, it has another length, or a number is not finite.
    pub fn list(&mut self, name: &'static str, len: Option<usize>) -> Result<Vec<f32>, FileError> {
        let list = self.npz.array(name)?.values;
        if let Some(len) = len.filter(|&len| len != list.len()) {
            return Err(self.broken(name, &format!("{len} numbers"), list.len()));
        }
        match list.iter().find(|number| !number.is_finite()) {
            Some(number) => Err(self.broken(name, "finite numbers", number)),
            None => Ok(list),
        }
    }

    /// The same of whole numbers that are not negative.
    ///
    /// # Errors
    /// As [`Checkpoint::list`]; also when a number is none of these.
    pub fn counts(&mut self, name: &'static str, len: Option<usize>) -> Result<Vec<u32>, FileError> {
        let list = self.list(name, len)?;
        let is_count = |number: &f32| (0.0..=MOST_EXACT).contains(number) && number.fract() == 0.0;
        match list.iter().find(|number| !is_count(number)) {
            Some(number) => Err(self.broken(name, &format!("whole numbers from 0 to {MOST_EXACT}"), number)),
            None => Ok(list.into_iter().map(|number| number as u32).collect()),
        }
    }

    /// The Gaussians, bound to a head of this many triangles.
    ///
    /// # Errors
    /// When a list is missing, has another length, or a number is out of its range.
    pub fn gaussians(&mut self, triangle_count: usize) -> Result<BoundGaussians, FileError> {
        let triangles = self.counts(TRIANGLES, None)?;
        let len = triangles.len();
        let sh = self.list(SH, None)?;
        let Some(sh_degree) = (0..=3).find(|degree| sh.len() == 3 * (degree + 1) * (degree + 1) * len) else {
            let expected = format!("those of {len} Gaussians, of degree 0 to 3");
            return Err(self.broken(SH, &expected, format!("{} numbers", sh.len())));
        };
        let opacities = self.list(OPACITIES, Some(len))?;
        if let Some(opacity) = opacities.iter().find(|opacity| !(0.0..=1.0).contains(*opacity)) {
            return Err(self.broken(OPACITIES, "numbers from 0 to 1", opacity));
        }
        let vectors = |list: Vec<f32>| list.chunks_exact(3).map(Vec3::from_slice).collect();
        let local = Gaussians {
            positions: vectors(self.list(POSITIONS, Some(3 * len))?),
            scales: vectors(self.list(SCALES, Some(3 * len))?),
            rotations: self.list(ROTATIONS, Some(4 * len))?.chunks_exact(4).map(Quat::from_slice).collect(),
            opacities,
            sh_degree,
            sh: sh.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
            antialiased: false,
        };
        BoundGaussians::new(local, triangles, triangle_count)
            .map_err(|error| self.broken(TRIANGLES, "triangles of the head model", error))
    }

    fn broken(&self, name: &'static str, expected: &str, found: impl ToString) -> FileError {
        FileProblem::field(name, expected, found.to_string()).in_file(self.npz.path())
    }
}

fn in_json(config: &TrainConfig) -> Value {
    serde_json::to_value(config).expect("numbers and text")
}

/// The first key, as `section.key`, that has another value, with both values.
fn changed(key: String, before: &Value, now: &Value) -> Option<(String, String, String)> {
    match (before, now) {
        (Value::Object(before), Value::Object(now)) => {
            let prefix = if key.is_empty() { key } else { key + "." };
            let mut keys = before.keys().chain(now.keys());
            keys.find_map(|key| {
                let of = |object: &Map<String, Value>| object.get(key).cloned().unwrap_or_default();
                changed(format!("{prefix}{key}"), &of(before), &of(now))
            })
        }
        _ => (before != now).then(|| (key, before.to_string(), now.to_string())),
    }
}
