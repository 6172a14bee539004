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
//! | `other_joints` | (T, 3 J) | rotations of the joints without such a role, in the model's order; for heads that have them |
//!
//! The names are FLAME's; other heads use them for what means the same.

use std::path::Path;

use glam::{Quat, Vec3};
use srflow_field::{Array, FileError, FileProblem, Npz, NpzArray, write_npz};

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
}

/// Parameters do not fit a head model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "{what}: the parameters have {found}, the head model {model} at most {most}; give the parameters of the same kind of head"
)]
pub struct ParametersError {
    /// Name of the array.
    pub what: &'static str,
    pub found: usize,
    pub model: String,
    pub most: usize,
}

impl PoseParameters {
    /// The parameters of a pose of `model`. [`HeadPose::offset`] has no place in them.
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
            ..HeadPose::default()
        }
    }
}

impl HeadParameters {
    /// Reads a file of parameters. `shape` and `static_offset` may be missing, as in files of motion alone; other arrays than those
    /// listed above are ignored.
    ///
    /// # Errors
    /// When the file cannot be read, an array is missing or has another shape, timesteps differ in number, or a number is not
    /// finite.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let mut file = Npz::open(path)?;
        let in_file = |problem| FileError { path: path.to_owned(), problem };
        let expr = file.array("expr")?;
        let &[timesteps, expressions] = &expr.shape[..] else {
            return Err(in_file(wrong_shape("expr", "(T, E)", &expr.shape)));
        };
        if timesteps == 0 {
            return Err(in_file(field("expr", "one timestep or more", "none")));
        }
        check_finite("expr", &expr).map_err(in_file)?;
        let mut rows = |name: &'static str, columns: usize| {
            let array = file.array(name)?;
            if array.shape != [timesteps, columns] {
                let expected = format!("({timesteps}, {columns}), as expr has {timesteps} timesteps");
                return Err(in_file(wrong_shape(name, &expected, &array.shape)));
            }
            check_finite(name, &array).map_err(in_file)?;
            Ok(array.values)
        };
        let [rotation, neck, jaw] = ["rotation", "neck_pose", "jaw_pose"].map(|name| rows(name, 3));
        let (rotation, neck, jaw) = (rotation?, neck?, jaw?);
        let (eyes, translation) = (rows("eyes_pose", 6)?, rows("translation", 3)?);
        let vector = |values: &[f32], number: usize| {
            values.as_chunks::<3>().0.get(number).map_or(Vec3::ZERO, |vector| Vec3::from_array(*vector))
        };
        let others = if file.has("other_joints") {
            let array = file.array("other_joints")?;
            let columns = array.shape.get(1).copied().unwrap_or(0);
            if array.shape != [timesteps, columns] || columns % 3 != 0 {
                return Err(in_file(wrong_shape("other_joints", "(T, 3 J)", &array.shape)));
            }
            check_finite("other_joints", &array).map_err(in_file)?;
            array.values
        } else {
            Vec::new()
        };
        let of_others = others.len() / timesteps / 3;
        let pose = |t: usize| PoseParameters {
            expr: expr.values[t * expressions..][..expressions].to_vec(),
            rotation: vector(&rotation, t),
            neck: vector(&neck, t),
            jaw: vector(&jaw, t),
            eyes: [vector(&eyes, 2 * t), vector(&eyes, 2 * t + 1)],
            other_joints: (0..of_others).map(|joint| vector(&others, t * of_others + joint)).collect(),
            translation: vector(&translation, t),
        };
        let poses = (0..timesteps).map(pose).collect();
        let mut optional = |name: &'static str| {
            if !file.has(name) {
                return Ok(Array { shape: vec![0], values: Vec::new() });
            }
            let array = file.array(name)?;
            check_finite(name, &array).map_err(in_file)?;
            Ok(array)
        };
        let (shape, offset) = (optional("shape")?, optional("static_offset")?);
        if shape.shape.iter().product::<usize>() != shape.shape.last().copied().unwrap_or(0) {
            return Err(in_file(wrong_shape("shape", "(S), of one head", &shape.shape)));
        }
        let static_offset = match offset.shape[..] {
            [0] => Vec::new(),
            [1, _, 3] | [_, 3] => {
                let vectors: Vec<Vec3> =
                    offset.values.as_chunks().0.iter().copied().map(Vec3::from_array).collect();
                if vectors.iter().all(|offset| *offset == Vec3::ZERO) { Vec::new() } else { vectors }
            }
            _ => return Err(in_file(wrong_shape("static_offset", "(1, V, 3)", &offset.shape))),
        };
        Ok(Self { shape: shape.values, static_offset, poses })
    }

    /// Writes the parameters for a head of `vertices` vertices with the arrays that GaussianAvatars' loader reads from the files
    /// of a capture. With `of_avatar` also those of the file beside a `point_cloud.ply`: `dynamic_offset`, which is zero.
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
        let dynamic = vec![0.0; if of_avatar { timesteps * vertices * 3 } else { 0 }];
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
        if of_avatar {
            arrays.push(("dynamic_offset", NpzArray::Float(&dynamic_shape, &dynamic)));
        }
        if others > 0 {
            arrays.push(("other_joints", NpzArray::Float(&others_shape, &other_joints)));
        }
        write_npz(path, &arrays)
    }

    /// Checks that `model` has all that the parameters give weights or offsets to.
    ///
    /// # Errors
    /// Names the array that is too long for the model.
    pub fn check(&self, model: &HeadModel) -> Result<(), ParametersError> {
        let expressions = self.poses.iter().map(|pose| pose.expr.len()).max().unwrap_or(0);
        for (what, found, most) in [
            ("shape", self.shape.len(), model.identities.len()),
            ("expr", expressions, model.expressions.len()),
            ("static_offset", self.static_offset.len(), model.template.len()),
        ] {
            if found > most {
                return Err(ParametersError { what, found, model: model.name.clone(), most });
            }
        }
        Ok(())
    }
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
