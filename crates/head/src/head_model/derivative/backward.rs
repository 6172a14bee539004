use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::super::{HeadModel, HeadPose, Shape, ShapedHead};
use super::{PosedJoint, entry_derivatives};

/// The gradient of a scalar with respect to the parameters of a head model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeadGradient {
    /// One per shape of the identity basis.
    pub identity: Vec<f64>,
    /// One per shape of the expression basis.
    pub expressions: Vec<f64>,
    /// With respect to a small rotation after that of each joint, about the axes of its parent, radians; see
    /// [`rotation_of_axis_angle`](crate::rotation_of_axis_angle).
    pub joints: Vec<DVec3>,
    pub translation: DVec3,
    /// With respect to the displacements of [`HeadModel::shaped_with_offset`], one per vertex.
    pub static_offset: Vec<Vec3>,
    /// With respect to [`HeadPose::offset`], one per vertex.
    pub offset: Vec<Vec3>,
}

/// Vertices are summed in blocks of this size, in order, so that sums do not depend on the number of threads.
const BLOCK: usize = 1024;

/// What a block of vertices adds to the sums over all.
#[derive(Clone)]
struct Sums {
    /// Weighted gradient of the vertices that follow each joint, and their moment about the origin.
    joints: Vec<[DVec3; 2]>,
    translation: DVec3,
}

impl HeadModel {
    /// The gradient of a scalar with respect to all parameters, given its gradient with respect to each vertex that
    /// [`HeadModel::vertices`] computes for `shaped` in `pose`. `identity` are the weights that `shaped` was made with. The
    /// result is the same for any number of threads.
    ///
    /// # Panics
    /// When there is not one gradient per vertex.
    pub fn backward(
        &self,
        identity: &[f32],
        shaped: &ShapedHead,
        pose: &HeadPose,
        gradients: &[Vec3],
    ) -> HeadGradient {
        assert_eq!(gradients.len(), self.template.len(), "one gradient per vertex");
        let mut unposed = Vec::new();
        let rest = self.unposed(shaped, pose, &mut unposed);
        let rest: Vec<DVec3> = rest.iter().map(|joint| joint.as_dvec3()).collect();
        let parents = || self.joints.iter().map(|joint| joint.parent);
        let local = |joint| pose.joint(joint).as_dquat();
        let joints = PosedJoint::chain(parents(), &rest, local, pose.translation.as_dvec3());

        let mut of_unposed = vec![DVec3::ZERO; gradients.len()];
        let sums: Vec<Sums> = of_unposed
            .par_chunks_mut(BLOCK)
            .enumerate()
            .map(|(block, out)| self.sums_of_block(block * BLOCK, out, &unposed, &joints, gradients))
            .collect();
        let sums = sums.into_iter().reduce(Sums::plus).unwrap_or_else(|| Sums::zero(self));
        let entries = self.corrective_entries(&of_unposed);

        // Each joint moves all below it.
        let mut below = sums.joints;
        for (joint, parent) in parents().enumerate().collect::<Vec<_>>().into_iter().rev() {
            if let Some(parent) = parent {
                let [force, moment] = below[joint];
                below[parent][0] += force;
                below[parent][1] += moment;
            }
        }
        let mut of_joints: Vec<DVec3> = joints
            .iter()
            .zip(&below)
            .map(|(joint, [force, moment])| {
                joint.parent_rotation.transpose() * (*moment - joint.position.cross(*force))
            })
            .collect();
        for (corrective, entries) in self.pose_correctives.iter().zip(&entries) {
            let slopes = entry_derivatives(joints[corrective.joint].local);
            of_joints[corrective.joint] +=
                DVec3::from_array(slopes.map(|slopes| slopes.iter().zip(entries).map(|(a, b)| a * b).sum()));
        }
        let of_rest: Vec<DVec3> = joints
            .iter()
            .zip(&below)
            .map(|(joint, [force, _])| (joint.parent_rotation - joint.rotation).transpose() * *force)
            .collect();
        let mut with_joints = of_unposed.clone();
        for (joint, of_rest) in self.joints.iter().zip(&of_rest) {
            for &(vertex, weight) in &joint.follows {
                with_joints[vertex as usize] += *of_rest * f64::from(weight);
            }
        }
        let by_expressions = if self.joints_follow_expressions { &with_joints } else { &of_unposed };

        let of_identity = self.identities.par_iter().enumerate().map(|(number, shape)| {
            let weight = identity.get(number).copied().unwrap_or(0.0);
            let displaced = self.joints.iter().zip(&of_rest);
            let of_joints = displaced.filter_map(|(joint, of_rest)| {
                joint.identities.get(number).map(|offset| offset.as_dvec3().dot(*of_rest))
            });
            of_shape(shape, weight, &with_joints) + of_joints.sum::<f64>()
        });
        let of_expressions = self.expressions.par_iter().enumerate().map(|(number, shape)| {
            of_shape(shape, pose.expressions.get(number).copied().unwrap_or(0.0), by_expressions)
        });
        let single = |gradients: &[DVec3]| gradients.iter().map(|gradient| gradient.as_vec3()).collect();
        HeadGradient {
            identity: of_identity.collect(),
            expressions: of_expressions.collect(),
            joints: of_joints,
            translation: sums.translation,
            static_offset: single(&with_joints),
            offset: single(by_expressions),
        }
    }

    /// Writes the gradients with respect to the vertices from number `first` before skinning into `out`, and sums over them.
    fn sums_of_block(
        &self,
        first: usize,
        out: &mut [DVec3],
        unposed: &[Vec3],
        joints: &[PosedJoint],
        gradients: &[Vec3],
    ) -> Sums {
        let mut sums = Sums::zero(self);
        for (vertex, out) in (first..).zip(out) {
            let (gradient, rest) = (gradients[vertex].as_dvec3(), unposed[vertex].as_dvec3());
            let mut skin = DMat3::ZERO;
            for &(joint, weight) in self.skinning.of(vertex) {
                let (posed, weight) = (&joints[joint as usize], f64::from(weight));
                skin += posed.rotation * weight;
                let force = gradient * weight;
                let [forces, moments] = &mut sums.joints[joint as usize];
                *forces += force;
                *moments += posed.point(rest).cross(force);
                sums.translation += force;
            }
            *out = skin.transpose() * gradient;
        }
        sums
    }

    /// The gradient with respect to each entry of each corrective's rotation.
    fn corrective_entries(&self, of_unposed: &[DVec3]) -> Vec<[f64; 9]> {
        let of = |entry: &super::super::Offsets| {
            entry.iter().map(|(vertex, offset)| offset.as_dvec3().dot(of_unposed[vertex as usize])).sum()
        };
        let correctives = self.pose_correctives.par_iter();
        correctives.map(|corrective| corrective.entries.each_ref().map(of)).collect()
    }
}

impl Sums {
    fn zero(model: &HeadModel) -> Self {
        Self { joints: vec![[DVec3::ZERO; 2]; model.joints.len()], translation: DVec3::ZERO }
    }

    fn plus(mut self, other: Self) -> Self {
        for (sum, other) in self.joints.iter_mut().zip(other.joints) {
            sum[0] += other[0];
            sum[1] += other[1];
        }
        self.translation += other.translation;
        self
    }
}

/// The gradient with respect to the weight of a shape.
fn of_shape(shape: &Shape, weight: f32, gradients: &[DVec3]) -> f64 {
    let along = |(vertex, offset): (u32, Vec3)| offset.as_dvec3().dot(gradients[vertex as usize]);
    let line: f64 = shape.offsets.iter().map(along).sum();
    if !(0.0..1.0).contains(&weight) {
        return line;
    }
    let slope = 4.0 - 8.0 * f64::from(weight);
    line + slope * shape.arc.iter().map(|offset| along(*offset)).sum::<f64>()
}
