//! Parameters of a head over time, in the files of VHAP and GaussianAvatars: `flame_param.npz`, `flame_param/00000.npz`.
//!
//! | array | shape | is |
//! |---|---|---|
//! | `shape` | (S) | weights of the identity basis |
//! | `expr` | (T, E) | weights of the expression basis |
//! | `rotation`, `neck_pose`, `jaw_pose` | (T, 3) | rotations of root, neck and jaw: axis times angle, radians |
//! | `eyes_pose` | (T, 6) | rotations of the left and the right eye |
//! | `translation` | (T, 3) | after the rotations, metres |
//! | `static_offset` | (1, V, 3) | displacement of each vertex at rest, metres |
//! | `dynamic_offset` | (T, V, 3) | displacement of each vertex at rest beyond the expression, metres |
//! | `other_joints` | (T, 3 J) | rotations of the joints without such a role, in the model's order; for heads that have them |
//!
//! The names are FLAME's; other heads use them for what means the same. A JSON file has the same names with nested lists, and
//! may leave out the dimension T for a single timestep: `{"jaw_pose": [0.2, 0, 0]}`.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{Quat, Vec3};
use serde_json::Value;
use srflow_core::excerpts;
use srflow_files::{
    Array, FileError, FileKind, FileProblem, Npz, NpzArray, parse_error_in_words, read_text, write_npz,
};

use crate::flame::FLAME_VERTICES;
use crate::{HeadModel, HeadPose, JointRole};

/// The identity of a head and its poses over time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeadParameters {
    /// Weights of the identity basis; missing ones are zero.
    pub shape: Vec<f32>,
    /// Displacement of each vertex at rest, metres; empty for none.
    pub static_offset: Vec<Vec3>,
    /// One per timestep.
    pub poses: Vec<PoseParameters>,
}

/// The pose of a head at one timestep. Rotations are axis times angle in radians, relative to the parent joint.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PoseParameters {
    /// Weights of the expression basis; missing ones are zero.
    pub expr: Vec<f32>,
    pub rotation: Vec3,
    pub neck: Vec3,
    pub jaw: Vec3,
    /// Left and right.
    pub eyes: [Vec3; 2],
    /// Of the joints without a role, in the model's order.
    pub other_joints: Vec<Vec3>,
    /// Metres, after the rotations.
    pub translation: Vec3,
    /// Displacement of each vertex at rest, metres; empty for none.
    pub dynamic_offset: Vec<Vec3>,
}

/// Parameters do not fit a head model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{what}: the parameters have {found}, the head model {model} has {most}; give the parameters of the same kind of head"
)]
pub struct ParametersError {
    /// Name of the array.
    pub what: &'static str,
    pub found: usize,
    pub model: String,
    pub most: usize,
}

impl PoseParameters {
    /// The parameters of a pose of `model`.
    pub fn of(model: &HeadModel, pose: &HeadPose) -> Self {
        let of_joint = |joint: usize| pose.joint(joint).to_scaled_axis();
        let of = |role| model.joint(role).map_or(Vec3::ZERO, of_joint);
        let others = model.joints.iter().enumerate().filter(|(_, joint)| joint.role.is_none());
        Self {
            expr: pose.expressions.clone(),
            rotation: of(JointRole::Root),
            neck: of(JointRole::Neck),
            jaw: of(JointRole::Jaw),
            eyes: [of(JointRole::LeftEye), of(JointRole::RightEye)],
            other_joints: others.map(|(number, _)| of_joint(number)).collect(),
            translation: pose.translation,
            dynamic_offset: pose.offset.clone(),
        }
    }

    /// The pose of `model`. Rotations of joints that the model lacks are ignored.
    pub fn pose(&self, model: &HeadModel) -> HeadPose {
        let mut others = self.other_joints.iter();
        let rotation = |role: Option<JointRole>| match role {
            Some(JointRole::Root) => self.rotation,
            Some(JointRole::Neck) => self.neck,
            Some(JointRole::Jaw) => self.jaw,
            Some(JointRole::LeftEye) => self.eyes[0],
            Some(JointRole::RightEye) => self.eyes[1],
            None => others.next().copied().unwrap_or_default(),
        };
        let joints = model.joints.iter().map(|joint| joint.role).map(rotation);
        HeadPose {
            expressions: self.expr.clone(),
            joints: joints.map(Quat::from_scaled_axis).collect(),
            translation: self.translation,
            offset: self.dynamic_offset.clone(),
        }
    }
}

impl HeadParameters {
    /// Reads a file of parameters, `.json` or `.npz`. Missing arrays are zero. VHAP's arrays of textures, lights and cameras are passed over,
    /// others with a note.
    ///
    /// # Errors
    /// When the file cannot be read, has none of the arrays, one under the name that another program gives it, an array has another
    /// shape, timesteps differ in number, or a number is not finite.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let mut tables = Tables::open(path)?;
        let in_file = |problem| FileError { path: path.to_owned(), problem };
        let unknown = unknown_names(tables.names()).map_err(in_file)?;
        if !unknown.is_empty() {
            let (path, names) = (path.display(), excerpts(unknown.iter().copied(), 12));
            log::warn!("{path}: {names} are not known; what they say is left out");
        }
        let mut arrays = BTreeMap::new();
        for name in TIMED.iter().map(|(name, _)| *name).chain(STILL) {
            if let Some(array) = tables.array(name)? {
                check_finite(name, &array).map_err(in_file)?;
                arrays.insert(name, array);
            }
        }
        Self::of(arrays).map_err(in_file)
    }

    fn of(mut arrays: BTreeMap<&'static str, Array>) -> Result<Self, FileProblem> {
        let Some((first, timesteps)) = TIMED.iter().find_map(|(name, _)| {
            let array = arrays.get(name)?;
            Some((*name, array.shape.first().copied().unwrap_or(0)))
        }) else {
            if arrays.is_empty() {
                let names: Vec<&str> = TIMED.iter().map(|(name, _)| *name).chain(STILL).collect();
                return Err(field("arrays", format!("some of {}", names.join(", ")), "none of them"));
            }
            return Self::of_timesteps(arrays, 1);
        };
        let of_first = arrays.get(first).is_some_and(|array| array.shape.len() > 1);
        if timesteps == 0 && of_first {
            return Err(field(first, "one timestep or more", "none"));
        }
        for (name, shape) in TIMED {
            let Some(array) = arrays.get(name) else { continue };
            let fits = match (name, &array.shape[..]) {
                ("expr", [_, _]) | ("dynamic_offset", [_, _, 3]) => true,
                ("other_joints", [_, columns]) => columns % 3 == 0,
                ("eyes_pose", [_, 6]) => true,
                ("rotation" | "neck_pose" | "jaw_pose" | "translation", [_, 3]) => true,
                _ => false,
            };
            if !fits || array.shape[0] != timesteps {
                let same = format!(", as {first} has {timesteps} timesteps");
                let expected = match name == first {
                    true => shape.to_owned(),
                    false => shape.replace('T', &timesteps.to_string()) + &same,
                };
                return Err(wrong_shape(name, &expected, &array.shape));
            }
        }
        // Many files have one of zeros for all vertices at all timesteps.
        arrays.retain(|name, array| {
            *name != "dynamic_offset" || array.values.iter().any(|value| *value != 0.0)
        });
        Self::of_timesteps(arrays, timesteps)
    }

    fn of_timesteps(
        mut arrays: BTreeMap<&'static str, Array>,
        timesteps: usize,
    ) -> Result<Self, FileProblem> {
        let row = |name: &str, t: usize| -> &[f32] {
            let Some(array) = arrays.get(name) else { return &[] };
            let width = array.values.len() / timesteps;
            &array.values[t * width..(t + 1) * width]
        };
        let vectors = |name: &str, t: usize| -> Vec<Vec3> {
            row(name, t).as_chunks().0.iter().map(|vector| Vec3::from_array(*vector)).collect()
        };
        let vector = |name: &str, t: usize| vectors(name, t).first().copied().unwrap_or_default();
        let pose = |t: usize| PoseParameters {
            expr: row("expr", t).to_vec(),
            rotation: vector("rotation", t),
            neck: vector("neck_pose", t),
            jaw: vector("jaw_pose", t),
            eyes: vectors("eyes_pose", t).try_into().unwrap_or_default(),
            other_joints: vectors("other_joints", t),
            translation: vector("translation", t),
            dynamic_offset: vectors("dynamic_offset", t),
        };
        let poses = (0..timesteps).map(pose).collect();
        let shape = arrays.remove("shape").unwrap_or(Array { shape: vec![0], values: Vec::new() });
        if shape.shape.iter().product::<usize>() != shape.shape.last().copied().unwrap_or(0) {
            return Err(wrong_shape("shape", "(S), of one head", &shape.shape));
        }
        let static_offset = match arrays.get("static_offset") {
            None => Vec::new(),
            Some(array) if !matches!(array.shape[..], [1, _, 3] | [_, 3]) => {
                return Err(wrong_shape("static_offset", "(1, V, 3)", &array.shape));
            }
            Some(array) if array.values.iter().all(|value| *value == 0.0) => Vec::new(),
            Some(array) => array.values.as_chunks().0.iter().copied().map(Vec3::from_array).collect(),
        };
        Ok(Self { shape: shape.values, static_offset, poses })
    }

    /// Writes the parameters for a head of `vertices` vertices with the arrays that GaussianAvatars' loader reads from the files
    /// of a capture. `dynamic_offset` is written if a pose has one, and with `of_avatar`, since the file beside a
    /// `point_cloud.ply` must have it.
    ///
    /// # Errors
    /// When the timesteps have different numbers of weights or joints, or the file cannot be written.
    pub fn write(&self, path: &Path, vertices: usize, of_avatar: bool) -> Result<(), FileError> {
        let timesteps = self.poses.len();
        let sizes = |pose: &PoseParameters| (pose.expr.len(), pose.other_joints.len());
        let (expressions, others) = self.poses.first().map_or((0, 0), sizes);
        if let Some(odd) = self.poses.iter().find(|pose| sizes(pose) != (expressions, others)) {
            let problem = field(
                "expr",
                format!("{expressions} weights and {others} other joints at every timestep"),
                format!("{:?}", sizes(odd)),
            );
            return Err(FileError { path: path.to_owned(), problem });
        }
        let rows = |of: fn(&PoseParameters) -> Vec<Vec3>| -> Vec<f32> {
            self.poses.iter().flat_map(of).flat_map(|vector| vector.to_array()).collect()
        };
        let expr: Vec<f32> = self.poses.iter().flat_map(|pose| pose.expr.iter().copied()).collect();
        let (rotation, neck, jaw) =
            (rows(|pose| vec![pose.rotation]), rows(|pose| vec![pose.neck]), rows(|pose| vec![pose.jaw]));
        let (eyes, translation) = (rows(|pose| pose.eyes.to_vec()), rows(|pose| vec![pose.translation]));
        let other_joints = rows(|pose| pose.other_joints.clone());
        let mut offset: Vec<f32> = self.static_offset.iter().flat_map(|offset| offset.to_array()).collect();
        offset.resize(3 * vertices, 0.0);
        let has_dynamic = of_avatar || self.poses.iter().any(|pose| !pose.dynamic_offset.is_empty());
        let mut dynamic: Vec<f32> = Vec::new();
        for (t, pose) in self.poses.iter().enumerate().filter(|_| has_dynamic) {
            dynamic.extend(pose.dynamic_offset.iter().take(vertices).flat_map(|offset| offset.to_array()));
            dynamic.resize((t + 1) * vertices * 3, 0.0);
        }
        let (three, six) = ([timesteps, 3], [timesteps, 6]);
        let (shape, expr_shape) = ([self.shape.len()], [timesteps, expressions]);
        let (offset_shape, dynamic_shape) = ([1, vertices, 3], [timesteps, vertices, 3]);
        let others_shape = [timesteps, 3 * others];
        let mut arrays = vec![
            ("translation", NpzArray::Float(&three, &translation)),
            ("rotation", NpzArray::Float(&three, &rotation)),
            ("neck_pose", NpzArray::Float(&three, &neck)),
            ("jaw_pose", NpzArray::Float(&three, &jaw)),
            ("eyes_pose", NpzArray::Float(&six, &eyes)),
            ("shape", NpzArray::Float(&shape, &self.shape)),
            ("expr", NpzArray::Float(&expr_shape, &expr)),
            ("static_offset", NpzArray::Float(&offset_shape, &offset)),
        ];
        if has_dynamic {
            arrays.push(("dynamic_offset", NpzArray::Float(&dynamic_shape, &dynamic)));
        }
        if others > 0 {
            arrays.push(("other_joints", NpzArray::Float(&others_shape, &other_joints)));
        }
        write_npz(path, &arrays)
    }

    /// Checks that `model` has all that the parameters give weights to, and as many vertices as they give offsets to. Offsets of FLAME
    /// as published also fit FLAME with teeth, which have none then.
    ///
    /// # Errors
    /// Names the array that does not fit the model.
    pub fn check(&self, model: &HeadModel) -> Result<(), ParametersError> {
        let most = |of: fn(&PoseParameters) -> usize| self.poses.iter().map(of).max().unwrap_or(0);
        for (what, found, most) in [
            ("shape", self.shape.len(), model.identities.len()),
            ("expr", most(|pose| pose.expr.len()), model.expressions.len()),
            ("dynamic_offset", most(|pose| pose.dynamic_offset.len()), model.template.len()),
            ("static_offset", self.static_offset.len(), model.template.len()),
        ] {
            let is_offset = what.ends_with("_offset");
            let vertices_match = [0, FLAME_VERTICES, most].contains(&found);
            if found > most || is_offset && !vertices_match {
                return Err(ParametersError { what, found, model: model.name.clone(), most });
            }
        }
        Ok(())
    }
}

/// The arrays that change over time, and their shapes.
const TIMED: [(&str, &str); 8] = [
    ("expr", "(T, E)"),
    ("rotation", "(T, 3)"),
    ("neck_pose", "(T, 3)"),
    ("jaw_pose", "(T, 3)"),
    ("eyes_pose", "(T, 6)"),
    ("translation", "(T, 3)"),
    ("other_joints", "(T, 3 J)"),
    ("dynamic_offset", "(T, V, 3)"),
];

/// The arrays that hold for all timesteps.
const STILL: [&str; 2] = ["shape", "static_offset"];

/// Names that DECA, EMOCA, SMIRK, FlashAvatar's tracker and smplx give to the arrays, and ours.
const OTHER_NAMES: [(&str, &str); 19] = [
    ("betas", "shape"),
    ("shape_params", "shape"),
    ("shapecode", "shape"),
    ("exp", "expr"),
    ("expression", "expr"),
    ("expression_params", "expr"),
    ("expcode", "expr"),
    ("global_orient", "rotation"),
    ("global_pose", "rotation"),
    ("pose", "rotation and jaw_pose, which are its columns 0 to 2 and 3 to 5"),
    ("posecode", "rotation and jaw_pose, which are its columns 0 to 2 and 3 to 5"),
    ("pose_params", "rotation and jaw_pose, which are its columns 0 to 2 and 3 to 5"),
    ("neck", "neck_pose"),
    ("jaw", "jaw_pose"),
    ("jaw_params", "jaw_pose"),
    ("eyes", "eyes_pose"),
    ("leye_pose", "eyes_pose, the left eye before the right"),
    ("reye_pose", "eyes_pose, the left eye before the right"),
    ("transl", "translation"),
];

/// Arrays of VHAP's tracking that say nothing of the head's shape or motion.
const HARMLESS: [&str; 10] = [
    "timestep_id",
    "n_processed_frames",
    "tex",
    "tex_extra",
    "tex_pca",
    "tex_painted",
    "lights",
    "focal_length",
    "camera_id",
    "image_size",
];

/// Names that mean nothing here.
///
/// # Errors
/// For one that another program gives to what has another name here.
fn unknown_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<Vec<&'a str>, FileProblem> {
    let ours = || TIMED.iter().map(|(name, _)| *name).chain(STILL).chain(HARMLESS);
    let unknown: Vec<&str> = names.filter(|name| !ours().any(|known| known == *name)).collect();
    for name in &unknown {
        if let Some((other, meant)) = OTHER_NAMES.iter().find(|(other, _)| other.eq_ignore_ascii_case(name)) {
            return Err(field("arrays", format!("the names of VHAP, as {meant}"), other));
        }
    }
    Ok(unknown)
}

/// A file of arrays by name.
enum Tables {
    Npz(Npz),
    Json { arrays: BTreeMap<String, Array>, names: Vec<String> },
}

impl Tables {
    fn open(path: &Path) -> Result<Self, FileError> {
        if path.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("json")) {
            return Npz::open(path).map(Self::Npz);
        }
        let text = read_text(path, FileKind::Json)?;
        let wrong = |found: String| {
            let problem = field("JSON", "an object of lists of numbers, equally long", found);
            FileError { path: path.to_owned(), problem }
        };
        let object: BTreeMap<String, Value> =
            serde_json::from_str(&text).map_err(|error| wrong(parse_error_in_words(&error)))?;
        let mut arrays = BTreeMap::new();
        for (name, shape) in TIMED.into_iter().chain(STILL.map(|name| (name, ""))) {
            let Some(value) = object.get(name) else { continue };
            let mut array = array_of(value).ok_or_else(|| wrong(format!("another value of `{name}`")))?;
            if array.shape.len() + 1 == shape.split(',').count() {
                array.shape.insert(0, 1);
            }
            arrays.insert(name.to_owned(), array);
        }
        Ok(Self::Json { arrays, names: object.into_keys().collect() })
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        let names = match self {
            Self::Npz(file) => file.names(),
            Self::Json { names, .. } => names,
        };
        names.iter().map(String::as_str)
    }

    fn array(&mut self, name: &str) -> Result<Option<Array>, FileError> {
        match self {
            Self::Npz(file) => file.has(name).then(|| file.array(name)).transpose(),
            Self::Json { arrays, .. } => Ok(arrays.remove(name)),
        }
    }
}

/// Nested lists as an array; `None` if they are not equally long or hold something else than numbers.
fn array_of(value: &Value) -> Option<Array> {
    if let Some(number) = value.as_f64() {
        return Some(Array { shape: Vec::new(), values: vec![number as f32] });
    }
    let items = value.as_array()?.iter().map(array_of).collect::<Option<Vec<_>>>()?;
    let inner = items.first().map_or(&[][..], |first| first.shape.as_slice());
    if items.iter().any(|item| item.shape != inner) {
        return None;
    }
    let shape = [&[items.len()], inner].concat();
    Some(Array { shape, values: items.into_iter().flat_map(|item| item.values).collect() })
}

fn field(field: &'static str, expected: impl ToString, found: impl ToString) -> FileProblem {
    FileProblem::Field { field, expected: expected.to_string(), found: found.to_string() }
}

fn wrong_shape(name: &'static str, expected: &str, found: &[usize]) -> FileProblem {
    field(name, format!("the shape {expected}"), format!("{found:?}"))
}

fn check_finite(name: &'static str, array: &Array) -> Result<(), FileProblem> {
    match array.values.iter().find(|value| !value.is_finite()) {
        None => Ok(()),
        Some(value) => Err(field(name, "finite numbers", value)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Result<HeadParameters, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.json");
        std::fs::write(&path, json).unwrap();
        HeadParameters::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn json_of_the_wrong_shape_is_named() {
        for (json, expected) in [
            (r#"{"other": [1]}"#, "some of expr, rotation"),
            (r#"[1]"#, "an object of lists"),
            (r#"{"expr": [[1, 2], [3]]}"#, "another value of `expr`"),
            (r#"{"expr": "a"}"#, "another value of `expr`"),
            (r#"{"rotation": [1, 2]}"#, "rotation: expected the shape (T, 3)"),
            (r#"{"rotation": 1}"#, "rotation: expected the shape"),
            (r#"{"rotation": []}"#, "rotation: expected the shape (T, 3)"),
            (r#"{"eyes_pose": [[1, 2, 3]]}"#, "eyes_pose: expected the shape (T, 6)"),
            (r#"{"shape": [[1], [2]]}"#, "of one head"),
            (r#"{"static_offset": [1, 2, 3]}"#, "(1, V, 3)"),
            (r#"{"expr": [[1], [2]], "jaw_pose": [0, 0, 0]}"#, "(2, 3), as expr has 2 timesteps"),
            (r#"{"expr": [1e60]}"#, "finite numbers"),
        ] {
            let error = read(json).unwrap_err();
            assert!(error.contains(expected), "{json}: {error}");
        }
    }

    #[test]
    fn json_may_hold_a_single_pose_alone() {
        let model = HeadModel::builtin(1);
        let parameters = read(r#"{"translation": [1, 0, 0], "jaw_pose": [0.1, 0, 0]}"#).unwrap();
        let [pose] = &parameters.poses[..] else { panic!("{parameters:?}") };
        let pose = pose.pose(&model);
        assert_eq!(pose.translation, Vec3::X);
        assert!(pose.joint(2).to_scaled_axis().distance(Vec3::X * 0.1) < 1e-6);
        assert_eq!(read(r#"{"shape": [0.5]}"#).map(|p| (p.shape, p.poses.len())), Ok((vec![0.5], 1)));
        let moved = read(r#"{"dynamic_offset": [[0, 0, 1]]}"#).unwrap();
        assert_eq!(moved.poses[0].dynamic_offset, [Vec3::Z]);
    }

    /// A file of another tracker would give a neutral face.
    #[test]
    fn names_of_other_programs_are_refused() {
        for (text, meant) in [
            (r#"{"shape": [1], "exp": [0.5], "pose": [0, 0, 0, 0.2, 0, 0]}"#, "as expr, found exp"),
            (r#"{"jaw": [0.4, 0, 0], "expr": [0.5]}"#, "as jaw_pose, found jaw"),
            (r#"{"expr": [0.5], "global_orient": [0, 0, 0]}"#, "as rotation, found global_orient"),
            (
                r#"{"expr": [0.5], "pose_params": [0, 0, 0]}"#,
                "as rotation and jaw_pose, which are its columns",
            ),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(meant), "{error}");
        }
        assert!(read(r#"{"expr": [0.5], "lights": [[1]], "focal_length": [1.5]}"#).is_ok());
        let unknown = |names: &[&'static str]| unknown_names(names.iter().copied()).unwrap().join(" ");
        assert_eq!(unknown(&["expr", "tex_extra", "eyelids", "shape", "other_joints"]), "eyelids");
    }
}
