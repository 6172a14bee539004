use std::borrow::Cow;
use std::collections::BTreeMap;

use glam::{Mat3, Quat, Vec3};
use serde::{Deserialize, Serialize};

mod derivative;
mod shape;
mod skeleton;
mod texture;
mod validation;

pub use derivative::{
    HeadGradient, HeadPoints, HeadState, LinearisedPoints, PointDerivatives, rotation_of_axis_angle,
};
pub use shape::{Offsets, PoseCorrective, Shape};
pub use skeleton::{Joint, JointRole, Skinning};
pub use texture::TextureMap;
pub use validation::HeadModelError;

use crate::{MeshColors, Splat};
use skeleton::joint_transforms;

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
    /// Eyeball. The iris is located by the centre of the eye and the rest gaze (+z).
    Eyeball,
    /// Upper or lower teeth.
    Teeth,
    /// Gums, tongue and the inside of the mouth.
    MouthInside,
    /// The cornea and other transparent parts in front of the eye: not dressed.
    Clear,
}

/// The half of the face that an action unit moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
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
    /// Index of a joint and its rotation at full intensity, as axis times angle in radians.
    pub joints: Vec<(usize, Vec3)>,
}

/// A head that can change shape and move: template, identity and expression bases, and joints with linear blend skinning, as
/// in FLAME (Li et al. 2017). Every kind of head is this struct, whatever file it comes from.
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
    /// At least one joint; parents come before their children, and every role occurs at most once.
    pub joints: Vec<Joint>,
    /// Whether expressions and [`HeadPose::offset`] displace the joints as the identity does, as in FLAME. Otherwise they move
    /// vertices alone.
    pub joints_follow_expressions: bool,
    /// Whether expressions are principal components, as in FLAME and GNM: weights of either sign, of deviation 1 among people. Otherwise
    /// each is a shape of its own, which a weight of 1 shows fully.
    pub expressions_are_components: bool,
    /// Joint weights of each vertex; they sum to 1.
    pub skinning: Skinning,
    /// Displacements by the rotations of joints; empty for plain linear blend skinning.
    pub pose_correctives: Vec<PoseCorrective>,
    /// Action units in terms of expressions and joints.
    pub action_units: Vec<ActionUnit>,
    /// Facial landmarks as triangle and barycentric coordinates: the 68 in dlib's order, then the model's others; empty if the
    /// model has none.
    pub landmarks: Vec<(u32, Vec3)>,
    /// Vertices of the two eyeballs, left and right, in ascending order.
    pub eyeballs: [Vec<u32>; 2],
    /// Texture coordinates, if the model has some.
    pub texture: Option<TextureMap>,
    /// The model's own colours, if it has some.
    pub colors: Option<MeshColors>,
    /// The model's own groups of vertices by name, such as the masks of FLAME; each in ascending order.
    pub vertex_groups: BTreeMap<String, Vec<u32>>,
    /// Gaussians that come with the model, at rest, instead of those that a seed dresses it with; empty for none. The model's last
    /// triangles carry one each, in this order. They are not part of its surface, have three vertices of their own, which are the model's
    /// last, and move rigidly.
    pub carried: Vec<Splat>,
}

/// A head model's template with an identity applied: the input of [`HeadModel::vertices`].
#[derive(Debug, Clone, PartialEq)]
pub struct ShapedHead {
    /// Vertices at rest, metres.
    pub vertices: Vec<Vec3>,
    /// Rest position of each joint, metres.
    pub joints: Vec<Vec3>,
}

/// The input of [`HeadModel::vertices`] that changes over time. The default is the head at rest.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeadPose {
    /// Weight of each expression of the model; missing ones are zero.
    pub expressions: Vec<f32>,
    /// Rotation of each joint of the model about its rest position, relative to its parent; missing ones do not rotate.
    pub joints: Vec<Quat>,
    /// Translation of the whole head, metres, after the rotations.
    pub translation: Vec3,
    /// Displacement of each vertex at rest, metres, beyond the expressions (`dynamic_offset` of VHAP); empty for none.
    pub offset: Vec<Vec3>,
}

impl HeadPose {
    /// The rotation of joint number `joint`.
    pub fn joint(&self, joint: usize) -> Quat {
        self.joints.get(joint).copied().unwrap_or(Quat::IDENTITY)
    }

    /// The rotation of joint number `joint`, to be changed.
    pub fn joint_mut(&mut self, joint: usize) -> &mut Quat {
        if self.joints.len() <= joint {
            self.joints.resize(joint + 1, Quat::IDENTITY);
        }
        &mut self.joints[joint]
    }
}

impl HeadModel {
    /// The index of the joint with this role, if the model has one.
    pub fn joint(&self, role: JointRole) -> Option<usize> {
        self.joints.iter().position(|joint| joint.role == Some(role))
    }

    /// The vertices and triangles of the surface, without the triangles that carry Gaussians. `vertices` are those of the model in some
    /// shape and pose.
    pub fn surface<'a>(&'a self, vertices: &'a [Vec3]) -> (&'a [Vec3], &'a [[u32; 3]]) {
        let carriers = self.carried.len();
        let of_surface = |count: usize, carrying: usize| count.saturating_sub(carrying);
        let triangles = of_surface(self.triangles.len(), carriers);
        (&vertices[..of_surface(vertices.len(), 3 * carriers)], &self.triangles[..triangles])
    }

    /// A pose with the head where it is in `other`, and its own face: the translation and the joints from the root to the neck are
    /// those of `other`; expressions, jaw and eyes stay.
    pub fn with_head_of(&self, pose: &HeadPose, other: &HeadPose) -> HeadPose {
        let mut moved = HeadPose { translation: other.translation, ..pose.clone() };
        let mut joint = Some(self.joint(JointRole::Neck).unwrap_or(0));
        while let Some(number) = joint {
            *moved.joint_mut(number) = other.joint(number);
            joint = self.joints.get(number).and_then(|joint| joint.parent);
        }
        moved
    }

    /// The template with the identity of the given weights, one per shape of `identities`; missing weights are zero, and
    /// excess weights are ignored.
    pub fn shaped(&self, identity: &[f32]) -> ShapedHead {
        self.shaped_with_offset(identity, &[])
    }

    /// As [`HeadModel::shaped`], with a displacement of each vertex in addition, metres (`static_offset` of VHAP); missing ones
    /// are zero, and excess ones are ignored. Joints with a regressor follow it, as in FLAME.
    pub fn shaped_with_offset(&self, identity: &[f32], offset: &[Vec3]) -> ShapedHead {
        let mut vertices = self.template.clone();
        for (shape, &weight) in self.identities.iter().zip(identity) {
            shape.add_to(&mut vertices, weight);
        }
        for (vertex, offset) in vertices.iter_mut().zip(offset) {
            *vertex += *offset;
        }
        let rest = self.joints.iter().map(|joint| {
            let moved = joint.identities.iter().zip(identity);
            let by_identity =
                moved.fold(joint.position, |position, (offset, weight)| position + *offset * *weight);
            by_identity + regressed_displacement(joint, &self.template, &vertices)
        });
        let joints = rest.collect();
        ShapedHead { vertices, joints }
    }

    /// Writes the vertices of `shaped` in `pose`, metres, into `out`, reusing its memory.
    ///
    /// Linear blend skinning as in FLAME: expressions and the pose's offset are added to the identity's vertices, the joints
    /// follow if the model says so, pose correctives are added, the joints rotate about their rest positions along the chain
    /// of their parents, every vertex follows its joints by their weights, and the translation is applied last.
    pub fn vertices(&self, shaped: &ShapedHead, pose: &HeadPose, out: &mut Vec<Vec3>) {
        let rest = self.unposed(shaped, pose, out);
        let posed_from_rest = joint_transforms(&self.joints, &rest, pose);
        for (vertex, weights) in out.iter_mut().zip(self.skinning.iter()) {
            let mut rotation = Mat3::ZERO;
            let mut translation = Vec3::ZERO;
            for &(joint, weight) in weights {
                let transform = &posed_from_rest[joint as usize];
                rotation += transform.rotation * weight;
                translation += transform.translation * weight;
            }
            *vertex = rotation * *vertex + translation;
        }
    }

    /// Writes the vertices of `shaped` with the expressions, offset and pose correctives of `pose`, before skinning, into `out`.
    /// Returns the rest positions of the joints.
    fn unposed<'a>(&self, shaped: &'a ShapedHead, pose: &HeadPose, out: &mut Vec<Vec3>) -> Cow<'a, [Vec3]> {
        out.clone_from(&shaped.vertices);
        for (shape, &weight) in self.expressions.iter().zip(&pose.expressions) {
            shape.add_to(out, weight);
        }
        for (vertex, offset) in out.iter_mut().zip(&pose.offset) {
            *vertex += *offset;
        }
        let rest = self.rest_joints(shaped, out);
        for corrective in &self.pose_correctives {
            let turn = Mat3::from_quat(pose.joint(corrective.joint)) - Mat3::IDENTITY;
            for (entry, weight) in corrective.entries.iter().zip(turn.transpose().to_cols_array()) {
                if weight != 0.0 {
                    entry.add_to(out, weight);
                }
            }
        }
        rest
    }

    /// Rest positions of the joints of `shaped` with an expression, whose vertices before pose correctives are `vertices`.
    fn rest_joints<'a>(&self, shaped: &'a ShapedHead, vertices: &[Vec3]) -> Cow<'a, [Vec3]> {
        if !self.joints_follow_expressions {
            return Cow::Borrowed(&shaped.joints);
        }
        let rest = self.joints.iter().zip(&shaped.joints);
        rest.map(|(joint, rest)| *rest + regressed_displacement(joint, &shaped.vertices, vertices)).collect()
    }

    /// Centres of the left and the right eyeball of `shaped`: the eyes' joints, or places behind the landmarks of the lids; `None` if
    /// the model has neither.
    pub fn eye_centres(&self, shaped: &ShapedHead) -> Option<[Vec3; 2]> {
        let landmarks: Vec<Vec3> = self.landmarks_on(&shaped.vertices).collect();
        let centre = |role: JointRole, first: usize| match self.joint(role) {
            Some(joint) => Some(shaped.joints[joint]),
            None => landmarks.get(first..first + 6).map(behind_lids),
        };
        Some([centre(JointRole::LeftEye, 42)?, centre(JointRole::RightEye, 36)?])
    }

    /// Vertices of these groups, as far as the model has them.
    pub(crate) fn in_groups(&self, names: &[&str]) -> Vec<u32> {
        names.iter().filter_map(|name| self.vertex_groups.get(*name)).flatten().copied().collect()
    }

    /// Where the landmarks lie on these vertices, which are those of the model in some shape and pose.
    pub fn landmarks_on(&self, vertices: &[Vec3]) -> impl Iterator<Item = Vec3> {
        self.landmarks.iter().map(|&(triangle, weights)| {
            let [a, b, c] = self.triangles[triangle as usize].map(|vertex| vertices[vertex as usize]);
            a * weights.x + b * weights.y + c * weights.z
        })
    }

    /// The model's own colour at a point of a triangle, sRGB from 0 to 1; `None` for a model without colours.
    pub fn color_at(&self, triangle: u32, weights: Vec3) -> Option<Vec3> {
        let vertices = self.triangles[triangle as usize];
        let colors = self.colors.as_ref()?;
        Some(colors.mean(triangle, vertices, self.texture.as_ref(), [weights]).truncate())
    }

    /// The pose with each of the given action units: (number, side, intensity 0 to 1).
    ///
    /// Units add up, but no expression exceeds its full weight: an eye closed by two units is closed. Components have no full weight;
    /// there, units that are the same in all but their number count once, with the larger intensity. Intensities are clamped to 0..1.
    /// [`Side::Both`] of a unit with halves uses both; one side of a unit without halves uses the whole of it.
    ///
    /// # Errors
    /// [`HeadModelError::NoActionUnit`] for a unit that this model does not have.
    pub fn pose_of_action_units(&self, units: &[(u8, Side, f32)]) -> Result<HeadPose, HeadModelError> {
        let mut expressions = vec![0.0_f32; self.expressions.len()];
        let mut full = vec![0.0_f32; self.expressions.len()];
        let mut turns = vec![Vec3::ZERO; self.joints.len()];
        let mut used: Vec<(&ActionUnit, f32)> = Vec::new();
        for &(number, side, intensity) in units {
            // max before min: a NaN intensity becomes 0.
            #[expect(clippy::manual_clamp, reason = "clamp keeps NaN")]
            let intensity = intensity.max(0.0).min(1.0);
            for unit in self.halves(number, side)? {
                let same = used.iter_mut().find(|(other, _)| self.are_same(other, unit));
                match same {
                    Some((_, most)) => *most = most.max(intensity),
                    None => used.push((unit, intensity)),
                }
            }
        }
        for (unit, intensity) in used {
            for &(expression, weight) in &unit.expressions {
                expressions[expression] += weight * intensity;
                if weight.abs() > full[expression].abs() {
                    full[expression] = weight;
                }
            }
            for &(joint, turn) in &unit.joints {
                turns[joint] += turn * intensity;
            }
        }
        if !self.expressions_are_components {
            for (weight, full) in expressions.iter_mut().zip(full) {
                *weight = weight.clamp(full.min(0.0), full.max(0.0));
            }
        }
        let joints = turns.into_iter().map(Quat::from_scaled_axis).collect();
        Ok(HeadPose { expressions, joints, ..HeadPose::default() })
    }

    /// Whether two units of components are one by two numbers, such as 43 and 45, and so must not add up.
    fn are_same(&self, a: &ActionUnit, b: &ActionUnit) -> bool {
        self.expressions_are_components && a.expressions == b.expressions && a.joints == b.joints
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

/// Centre of the eyeball behind these landmarks of the lids, from one corner to the other: as far behind the corners as in an
/// average head.
fn behind_lids(lids: &[Vec3]) -> Vec3 {
    let corners = lids[0].distance(lids[3]);
    (lids[0] + lids[3]) * 0.5 - Vec3::Z * (0.3 * corners)
}

/// How far the regressor moves a joint when its vertices move.
fn regressed_displacement(joint: &Joint, from: &[Vec3], to: &[Vec3]) -> Vec3 {
    joint.follows.iter().fold(Vec3::ZERO, |sum, &(vertex, weight)| {
        sum + weight * (to[vertex as usize] - from[vertex as usize])
    })
}

#[cfg(test)]
mod tests;
