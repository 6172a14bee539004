use glam::{Mat3, Vec3};

use super::HeadPose;

/// What a joint is for. Models have these joints under their own names, and some lack one or the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum JointRole {
    /// Moves the whole model. Every model has it, as its first joint.
    Root,
    /// Moves the head on the neck.
    Neck,
    /// Opens the mouth.
    Jaw,
    /// Rotates the subject's left eyeball.
    LeftEye,
    /// Rotates the subject's right eyeball.
    RightEye,
}

impl JointRole {
    /// All roles, in the order of FLAME's joints.
    pub const ALL: [JointRole; 5] =
        [JointRole::Root, JointRole::Neck, JointRole::Jaw, JointRole::LeftEye, JointRole::RightEye];

    /// The name of the role, which is that of the joint in the built-in head.
    pub const fn name(self) -> &'static str {
        match self {
            JointRole::Root => "root",
            JointRole::Neck => "neck",
            JointRole::Jaw => "jaw",
            JointRole::LeftEye => "left_eye",
            JointRole::RightEye => "right_eye",
        }
    }
}

/// A joint of a head model.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// The model's own name.
    pub name: String,
    pub role: Option<JointRole>,
    /// Index of the parent joint, smaller than this joint's own; `None` for the first joint alone.
    pub parent: Option<usize>,
    /// Position in the template, metres.
    pub position: Vec3,
    /// Row of the joint regressor: vertices and weights. The joint moves by the weighted sum of these vertices' displacements
    /// from the template (equivalent to FLAME's regressor, given the position in the template).
    pub follows: Vec<(u32, f32)>,
    /// Displacement of the joint by each identity at weight 1, metres, in addition to `follows`; empty for none. GNM has these
    /// instead of a regressor.
    pub identities: Vec<Vec3>,
}

impl Joint {
    /// The five joints of FLAME at these positions, in the order of [`JointRole::ALL`], which do not depend on the identity.
    pub fn of_roles(positions: [Vec3; 5]) -> Vec<Self> {
        let parents = [None, Some(0), Some(1), Some(1), Some(1)];
        let joint = |((role, position), parent): ((JointRole, Vec3), Option<usize>)| Self {
            name: role.name().to_owned(),
            role: Some(role),
            parent,
            position,
            follows: Vec::new(),
            identities: Vec::new(),
        };
        JointRole::ALL.into_iter().zip(positions).zip(parents).map(joint).collect()
    }
}

/// The joint weights of every vertex.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Skinning {
    /// Where each vertex's weights end; they start where those of the vertex before end.
    ends: Vec<u32>,
    weights: Vec<(u32, f32)>,
}

impl Skinning {
    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Adds the weights of the next vertex: joints and weights. Zeros are dropped.
    pub fn push(&mut self, weights: impl IntoIterator<Item = (u32, f32)>) {
        self.weights.extend(weights.into_iter().filter(|(_, weight)| *weight != 0.0));
        self.ends.push(self.weights.len() as u32);
    }

    /// Joints and weights of a vertex; none beyond the last vertex.
    pub fn of(&self, vertex: usize) -> &[(u32, f32)] {
        let Some(&end) = self.ends.get(vertex) else { return &[] };
        let start = vertex.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.weights[start as usize..end as usize]
    }

    /// Weight of one joint for a vertex.
    pub fn weight(&self, vertex: usize, joint: usize) -> f32 {
        self.of(vertex).iter().filter(|(j, _)| *j as usize == joint).map(|(_, weight)| weight).sum()
    }

    /// The weights of every vertex, in order.
    pub fn iter(&self) -> impl Iterator<Item = &[(u32, f32)]> {
        (0..self.len()).map(|vertex| self.of(vertex))
    }
}

/// From one row of weights per vertex, one for each joint.
impl<const JOINTS: usize> FromIterator<[f32; JOINTS]> for Skinning {
    fn from_iter<I: IntoIterator<Item = [f32; JOINTS]>>(rows: I) -> Self {
        let mut skinning = Self::default();
        for row in rows {
            skinning.push((0..).zip(row));
        }
        skinning
    }
}

/// Transform of a point that follows only this joint: `rotation * point + translation`.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointTransform {
    pub rotation: Mat3,
    pub translation: Vec3,
}

/// The transform of each joint from rest to `pose`: joints rotate about their rest positions along the chain of parents, and
/// the translation is applied last.
pub(super) fn joint_transforms(joints: &[Joint], rest: &[Vec3], pose: &HeadPose) -> Vec<JointTransform> {
    let unmoved = JointTransform { rotation: Mat3::IDENTITY, translation: pose.translation };
    let mut posed_from_rest: Vec<JointTransform> = Vec::with_capacity(joints.len());
    for (index, (joint, &rest)) in joints.iter().zip(rest).enumerate() {
        let parent = joint.parent.map_or(unmoved, |parent| posed_from_rest[parent]);
        let rotation = parent.rotation * Mat3::from_quat(pose.joint(index));
        let position = parent.rotation * rest + parent.translation;
        posed_from_rest.push(JointTransform { rotation, translation: position - rotation * rest });
    }
    posed_from_rest
}
