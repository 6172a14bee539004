//! Head avatars.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{Quat, Vec3};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use srflow_avatar::{HeadSource, PosedHead};
use srflow_head::{HeadPose, JointRole, Side};

use crate::arrays;
use crate::compute::compute;
use crate::errors::exception;
use crate::gaussians::Gaussians;

/// A person: a head that can be posed, and the Gaussians bound to it.
///
/// World units are metres. The head looks along +z, +y is up, and +x is the subject's left. Make one with `Avatar.builtin` or
/// `Avatar.read`.
///
/// >>> avatar = srflow.Avatar.builtin(7)
/// >>> rest, smile = avatar.pose(), avatar.pose({12: 0.8})
/// >>> frame = srflow.rasterize(rest, srflow.Camera.facing(rest), next=smile)   # colour and exact flow
///
/// The Gaussians of all poses are the same ones in the same order.
#[pyclass(module = "srflow", frozen)]
pub struct Avatar {
    avatar: Arc<srflow_avatar::Avatar>,
    head: HeadSource,
}

impl Avatar {
    fn of(py: Python<'_>, head: HeadSource, seed: u64) -> PyResult<Self> {
        let source = head.clone();
        let avatar = compute(py, move || source.avatar(seed))?.map_err(exception)?;
        Ok(Self { avatar: Arc::new(avatar), head })
    }

    fn gaussians(&self, py: Python<'_>, pose: HeadPose) -> PyResult<Gaussians> {
        let avatar = self.avatar.clone();
        let gaussians = compute(py, move || {
            let mut gaussians = srflow_splat::Gaussians::default();
            avatar.gaussians_into(&pose, &mut PosedHead::default(), &mut gaussians);
            gaussians
        })?;
        Ok(gaussians.into())
    }

    /// Turns a joint, beyond what action units do.
    fn turn(&self, pose: &mut HeadPose, role: JointRole, name: &str, turn: Vec3) -> PyResult<()> {
        let model = self.avatar.model();
        let joint = model.joint(role).ok_or_else(|| {
            let (model, joint) = (&model.name, role.name());
            PyValueError::new_err(format!("{name}: the head model {model} has no joint {joint}"))
        })?;
        *pose.joint_mut(joint) *= Quat::from_scaled_axis(turn);
        Ok(())
    }
}

#[pymethods]
impl Avatar {
    /// The person of `seed` on the built-in head: the seed determines shape, skin, hair and eyes, alike on every machine.
    #[staticmethod]
    #[pyo3(signature = (seed: "int" = 1) -> "Avatar")]
    fn builtin(py: Python<'_>, seed: u64) -> PyResult<Self> {
        Self::of(py, HeadSource::builtin(), seed)
    }

    /// A person on any head: `head` is what `--head` of the command line takes ("builtin", "ict:DIR", "flame:FILE", "gltf:FILE",
    /// "avatar:DIR", ...), or the folder of a trained avatar. `seed` determines what the files leave open.
    #[staticmethod]
    #[pyo3(signature = (head: "str | os.PathLike[str]", seed: "int" = 1) -> "Avatar")]
    fn read(py: Python<'_>, head: PathBuf, seed: u64) -> PyResult<Self> {
        let text = head.to_string_lossy();
        let source = match text.parse::<HeadSource>() {
            Err(_) if Path::new(&head).is_dir() => format!("avatar:{text}").parse(),
            source => source,
        };
        let source = source.map_err(|error| PyValueError::new_err(format!("head: {error}")))?;
        Self::of(py, source, seed)
    }

    /// The Gaussians in a pose. Without arguments the head is at rest.
    ///
    /// `units` are action units of FACS and their intensities from 0 to 1: `{12: 0.8, "6_L": 0.5}`; `_L` and `_R` are the subject's left and
    /// right half. The others are turns, axis times angle in radians, float32, 3: `rotation` of everything, `neck`, `jaw`, and `eyes` (3, or
    /// 2 x 3 for left and right). A turn around +x looks down, around +y to the subject's left. `translation` is in metres.
    #[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
    #[pyo3(signature = (
        units: "dict[int | str, float] | None" = None,
        *,
        rotation: "ArrayLike | None" = None,
        neck: "ArrayLike | None" = None,
        jaw: "ArrayLike | None" = None,
        eyes: "ArrayLike | None" = None,
        translation: "ArrayLike | None" = None
    ) -> "Gaussians")]
    fn pose(
        &self,
        py: Python<'_>,
        units: Option<&Bound<'_, PyDict>>,
        rotation: Option<&Bound<'_, PyAny>>,
        neck: Option<&Bound<'_, PyAny>>,
        jaw: Option<&Bound<'_, PyAny>>,
        eyes: Option<&Bound<'_, PyAny>>,
        translation: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Gaussians> {
        let units = units.map_or_else(|| Ok(Vec::new()), action_units)?;
        let mut pose = self.avatar.model().pose_of_action_units(&units).map_err(exception)?;
        for (name, role, given) in [
            ("rotation", JointRole::Root, rotation),
            ("neck", JointRole::Neck, neck),
            ("jaw", JointRole::Jaw, jaw),
        ] {
            if let Some(given) = given {
                self.turn(&mut pose, role, name, vector(given, name, "axis times angle, float32 3")?)?;
            }
        }
        if let Some(eyes) = eyes {
            let [left, right] = both_eyes(eyes)?;
            self.turn(&mut pose, JointRole::LeftEye, "eyes", left)?;
            self.turn(&mut pose, JointRole::RightEye, "eyes", right)?;
        }
        if let Some(translation) = translation {
            pose.translation = vector(translation, "translation", "metres, float32 3")?;
        }
        self.gaussians(py, pose)
    }

    /// The Gaussians at a timestep, from 0, of the motion that the person was recorded in.
    #[pyo3(signature = (timestep: "int") -> "Gaussians")]
    fn at(&self, py: Python<'_>, timestep: usize) -> PyResult<Gaussians> {
        let motion = self.avatar.own_motion();
        let pose = motion
            .get(timestep)
            .ok_or_else(|| PyIndexError::new_err(format!("timestep {timestep} of {}", motion.len())))?;
        self.gaussians(py, pose.pose(self.avatar.model()))
    }

    /// Number of timesteps of the motion that the person was recorded in; 0 for one that was made up.
    #[getter]
    fn timesteps(&self) -> usize {
        self.avatar.own_motion().len()
    }

    /// Numbers of the action units that the head has, ascending.
    #[getter]
    fn action_units(&self) -> Vec<u32> {
        let mut numbers: Vec<u32> =
            self.avatar.model().action_units.iter().map(|unit| unit.number.into()).collect();
        numbers.sort_unstable();
        numbers.dedup();
        numbers
    }

    fn __repr__(&self) -> String {
        format!("srflow.Avatar({})  # {} Gaussians", self.head, self.avatar.bound().len())
    }
}

fn vector(object: &Bound<'_, PyAny>, name: &str, expected: &str) -> PyResult<Vec3> {
    finite(Vec3::from_array(arrays::vector(object, name, expected)?), name)
}

fn finite(vector: Vec3, name: &str) -> PyResult<Vec3> {
    let error = || PyValueError::new_err(format!("{name}: expected finite numbers, found {vector}"));
    if vector.is_finite() { Ok(vector) } else { Err(error()) }
}

/// Turns of the left and the right eye.
fn both_eyes(object: &Bound<'_, PyAny>) -> PyResult<[Vec3; 2]> {
    const EXPECTED: &str = "axis times angle, float32 3 (of both) or 2 x 3 (left, right)";
    let (shape, _) = arrays::numbers::<f32>(object, "eyes", EXPECTED)?;
    if shape.len() == 1 {
        return Ok([vector(object, "eyes", EXPECTED)?; 2]);
    }
    let turns = arrays::shaped::<f32>(object, "eyes", EXPECTED, &[2, 3])?;
    let [left, right] = [0, 3].map(|at| Vec3::from_slice(&turns[at..at + 3]));
    Ok([finite(left, "eyes")?, finite(right, "eyes")?])
}

/// `{12: 0.8, "6_L": 0.5}`.
fn action_units(given: &Bound<'_, PyDict>) -> PyResult<Vec<(u8, Side, f32)>> {
    let mut units = Vec::new();
    for (name, intensity) in given {
        let text = name.to_string();
        let (number, side) = match text.split_once('_') {
            Some((number, "L")) => (number, Side::Left),
            Some((number, "R")) => (number, Side::Right),
            _ => (text.as_str(), Side::Both),
        };
        let number = number.parse::<u8>().map_err(|_| {
            PyValueError::new_err(format!(
                "units: expected numbers of action units, as 12, or \"12_L\" for the subject's left half, found {name}"
            ))
        })?;
        let found = intensity.extract::<f32>().ok().filter(|value| (0.0..=1.0).contains(value));
        let intensity = found.ok_or_else(|| {
            PyValueError::new_err(format!(
                "units: expected an intensity from 0 to 1 for unit {text}, found {intensity}"
            ))
        })?;
        units.push((number, side, intensity));
    }
    Ok(units)
}
