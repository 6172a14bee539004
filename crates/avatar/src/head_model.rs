use std::ops::Range;

use glam::{Mat3, Quat, Vec3};

mod validation;

pub use validation::HeadModelError;

/// The joints of every head model, in FLAME's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Joint {
    /// Moves the whole head and neck.
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

impl Joint {
    /// All joints, in order.
    pub const ALL: [Joint; 5] = [Joint::Root, Joint::Neck, Joint::Jaw, Joint::LeftEye, Joint::RightEye];

    /// The parent joint; `None` for the root.
    pub fn parent(self) -> Option<Joint> {
        match self {
            Joint::Root => None,
            Joint::Neck => Some(Joint::Root),
            Joint::Jaw | Joint::LeftEye | Joint::RightEye => Some(Joint::Neck),
        }
    }
}

/// The region of a triangle, which determines how it is dressed with Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Region {
    /// Facial skin, ears included.
    Skin,
    /// Skin under the hair.
    Scalp,
    /// The vermilion of the lips.
    Lips,
    /// Skin with an eyebrow.
    Brow,
    /// Rim of an eyelid, with lashes.
    LidMargin,
    /// Wet pink lining of the eyelids, and the caruncle in the inner corner of the eye.
    InnerLid,
    /// Neck and shoulders.
    Neck,
    /// Eyeball. The iris is located by the eye joint and the rest gaze (+z).
    Eyeball,
    /// Upper or lower teeth.
    Teeth,
    /// Gums, tongue and the inside of the mouth.
    MouthInside,
}

/// A named displacement of some vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// The model's own name, e.g. `AU12_L` or `mouthSmile_L`.
    pub name: String,
    /// Vertex index and displacement in metres at weight 1; vertices that do not move are omitted.
    pub offsets: Vec<(u32, Vec3)>,
    /// Curvature of the path between weights 0 and 1: the largest deviation from the straight line, at weight 0.5, scaled by
    /// `4w(1 - w)`, and zero outside. An eyelid needs it to slide around the eyeball. Empty for the purely linear shapes of
    /// FLAME and ICT-FaceKit.
    pub arc: Vec<(u32, Vec3)>,
}

impl Shape {
    /// A linear shape.
    pub fn linear(name: impl Into<String>, offsets: Vec<(u32, Vec3)>) -> Self {
        Self { name: name.into(), offsets, arc: Vec::new() }
    }

    fn add_to(&self, vertices: &mut [Vec3], weight: f32) {
        if weight == 0.0 {
            return;
        }
        for &(vertex, offset) in &self.offsets {
            vertices[vertex as usize] += offset * weight;
        }
        if weight > 0.0 && weight < 1.0 {
            let bend = 4.0 * weight * (1.0 - weight);
            for &(vertex, offset) in &self.arc {
                vertices[vertex as usize] += offset * bend;
            }
        }
    }
}

/// The half of the face that an action unit moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// Both halves, or an action unit without halves.
    Both,
    /// The subject's left.
    Left,
    /// The subject's right.
    Right,
}

/// A FACS action unit in terms of one head model.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionUnit {
    /// Number in FACS, e.g. 12.
    pub number: u8,
    /// A unit with halves is listed as `Left` and as `Right`; [`Side::Both`] adds both.
    pub side: Side,
    /// Expression and its weight at full intensity.
    pub expressions: Vec<(usize, f32)>,
    /// Joint and its rotation at full intensity, as axis times angle in radians.
    pub joints: Vec<(Joint, Vec3)>,
}

/// A head that can change shape and move: template, identity and expression bases, and joints with linear blend skinning, as
/// in FLAME (Li et al. 2017). The built-in head, ICT-FaceKit and FLAME are all this struct.
#[derive(Debug, Clone)]
pub struct HeadModel {
    /// E.g. `builtin`, `ict`.
    pub name: String,
    /// Vertices at rest, metres.
    pub template: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Region of each triangle.
    pub regions: Vec<Region>,
    /// Identity basis.
    pub identities: Vec<Shape>,
    /// Expression basis.
    pub expressions: Vec<Shape>,
    /// Position of each [`Joint`] in the template.
    pub joints: [Vec3; 5],
    /// Joint regressor: for each joint, vertices and weights. A joint moves by the weighted sum of these vertices'
    /// displacements from the template (equivalent to FLAME's regressor, given the template's joints).
    pub joint_regressor: [Vec<(u32, f32)>; 5],
    /// Joint weights of each vertex, in the order of [`Joint`]; they sum to 1.
    pub skinning: Vec<[f32; 5]>,
    /// Action units in terms of expressions and joints.
    pub action_units: Vec<ActionUnit>,
    /// 68 facial landmarks (dlib order) as triangle and barycentric coordinates; empty if the model has none.
    pub landmarks: Vec<(u32, Vec3)>,
    /// Vertices of the two eyeballs, left and right.
    pub eyeballs: [Range<u32>; 2],
}

/// A head model's template with an identity applied: the input of [`HeadModel::vertices`].
#[derive(Debug, Clone, PartialEq)]
pub struct ShapedHead {
    /// Vertices at rest, metres.
    pub vertices: Vec<Vec3>,
    /// Rest position of each [`Joint`], metres.
    pub joints: [Vec3; 5],
}

/// The input of [`HeadModel::vertices`] that changes over time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeadPose {
    /// Weight of each expression of the model; missing ones are zero.
    pub expressions: Vec<f32>,
    /// Rotation of each [`Joint`] about its rest position, relative to its parent.
    pub joints: [Quat; 5],
    /// Translation of the whole head, metres, after the rotations.
    pub translation: Vec3,
}

impl HeadModel {
    /// The template with the identity of the given weights, one per shape of `identities`; missing weights are zero, and
    /// excess weights are ignored.
    pub fn shaped(&self, identity: &[f32]) -> ShapedHead {
        let mut vertices = self.template.clone();
        for (shape, &weight) in self.identities.iter().zip(identity) {
            shape.add_to(&mut vertices, weight);
        }
        let joints = std::array::from_fn(|joint| {
            let displacement =
                self.joint_regressor[joint].iter().fold(Vec3::ZERO, |sum, &(vertex, weight)| {
                    sum + weight * (vertices[vertex as usize] - self.template[vertex as usize])
                });
            self.joints[joint] + displacement
        });
        ShapedHead { vertices, joints }
    }

    /// Writes the vertices of `shaped` in `pose`, metres, into `out`, reusing its memory.
    ///
    /// Linear blend skinning as in FLAME: expressions are added to the identity's vertices, the joints rotate about their rest
    /// positions along the chain root, neck, {jaw, eyes}, every vertex follows its joints by their weights, and the
    /// translation is applied last.
    pub fn vertices(&self, shaped: &ShapedHead, pose: &HeadPose, out: &mut Vec<Vec3>) {
        out.clone_from(&shaped.vertices);
        for (shape, &weight) in self.expressions.iter().zip(&pose.expressions) {
            shape.add_to(out, weight);
        }
        let posed_from_rest = joint_transforms(&shaped.joints, pose);
        for (vertex, weights) in out.iter_mut().zip(&self.skinning) {
            let mut rotation = Mat3::ZERO;
            let mut translation = Vec3::ZERO;
            for (transform, &weight) in posed_from_rest.iter().zip(weights) {
                if weight != 0.0 {
                    rotation += transform.rotation * weight;
                    translation += transform.translation * weight;
                }
            }
            *vertex = rotation * *vertex + translation;
        }
    }

    /// Where the landmarks lie on these vertices, which are those of the model in some shape and pose.
    pub fn landmarks_on(&self, vertices: &[Vec3]) -> impl Iterator<Item = Vec3> {
        self.landmarks.iter().map(|&(triangle, weights)| {
            let [a, b, c] = self.triangles[triangle as usize].map(|vertex| vertices[vertex as usize]);
            a * weights.x + b * weights.y + c * weights.z
        })
    }

    /// The pose with each of the given action units: (number, side, intensity 0 to 1).
    ///
    /// Units add up, but no expression exceeds its full weight: an eye closed by two units is closed. Intensities are clamped
    /// to 0..1. [`Side::Both`] of a unit with halves uses both; one side of a unit without halves uses the whole of it.
    ///
    /// # Errors
    /// [`HeadModelError::NoActionUnit`] for a unit that this model does not have.
    pub fn pose_of_action_units(&self, units: &[(u8, Side, f32)]) -> Result<HeadPose, HeadModelError> {
        let mut expressions = vec![0.0_f32; self.expressions.len()];
        let mut full = vec![0.0_f32; self.expressions.len()];
        let mut turns = [Vec3::ZERO; 5];
        for &(number, side, intensity) in units {
            // max before min: a NaN intensity becomes 0.
            #[expect(clippy::manual_clamp, reason = "clamp keeps NaN")]
            let intensity = intensity.max(0.0).min(1.0);
            for unit in self.halves(number, side)? {
                for &(expression, weight) in &unit.expressions {
                    expressions[expression] += weight * intensity;
                    if weight.abs() > full[expression].abs() {
                        full[expression] = weight;
                    }
                }
                for &(joint, turn) in &unit.joints {
                    turns[joint as usize] += turn * intensity;
                }
            }
        }
        for (weight, full) in expressions.iter_mut().zip(full) {
            *weight = weight.clamp(full.min(0.0), full.max(0.0));
        }
        Ok(HeadPose { expressions, joints: turns.map(Quat::from_scaled_axis), translation: Vec3::ZERO })
    }

    /// The listed units that make up one side, or both, of unit `number`.
    fn halves(&self, number: u8, side: Side) -> Result<Vec<&ActionUnit>, HeadModelError> {
        let shown = |unit: &ActionUnit| {
            unit.number == number && (side == Side::Both || unit.side == Side::Both || unit.side == side)
        };
        let found: Vec<_> = self.action_units.iter().filter(|unit| shown(unit)).collect();
        if found.is_empty() {
            let mut available: Vec<u8> = self.action_units.iter().map(|unit| unit.number).collect();
            available.sort_unstable();
            available.dedup();
            return Err(HeadModelError::NoActionUnit { model: self.name.clone(), number, side, available });
        }
        Ok(found)
    }
}

/// Transform of a point that follows only this joint: `rotation * point + translation`.
#[derive(Debug, Clone, Copy)]
struct JointTransform {
    rotation: Mat3,
    translation: Vec3,
}

fn joint_transforms(rest: &[Vec3; 5], pose: &HeadPose) -> [JointTransform; 5] {
    let mut posed_from_rest = [JointTransform { rotation: Mat3::IDENTITY, translation: pose.translation }; 5];
    for joint in Joint::ALL {
        let index = joint as usize;
        let parent = joint.parent().map_or(posed_from_rest[index], |parent| posed_from_rest[parent as usize]);
        let turn = Mat3::from_quat(pose.joints[index]);
        let rotation = parent.rotation * turn;
        let position = parent.rotation * rest[index] + parent.translation;
        posed_from_rest[index] = JointTransform { rotation, translation: position - rotation * rest[index] };
    }
    posed_from_rest
}

#[cfg(test)]
mod tests;
