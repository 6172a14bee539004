//! Derivatives of a head model's vertices with respect to its parameters, in f64.
//!
//! Rotations are differentiated by a small rotation w (axis times angle, radians, in the axes of the parent joint) that is applied
//! after the joint's own: `R' = exp(w) R`. Parameters that are axis times angle themselves, as VHAP's, differ by the matrix of
//! [`rotation_of_axis_angle`].

mod backward;
mod points;
#[cfg(test)]
mod tests;

use glam::{DMat3, DQuat, DVec3};

pub use backward::HeadGradient;
pub use points::{HeadPoints, HeadState, LinearisedPoints, PointDerivatives};

/// The small rotation w that follows from a small change of `r` in `R = exp(r)`: the matrix J in `exp(r + d) = exp(J d) exp(r)`
/// to first order in d (left Jacobian of SO(3)). The gradient with respect to `r` is `J^T` times the one with respect to w.
pub fn rotation_of_axis_angle(r: DVec3) -> DMat3 {
    let angle = r.length();
    // Below this the series is exact to f64.
    let (a, b) = if angle < 1e-4 {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0)
    } else {
        let square = angle * angle;
        ((1.0 - libm::cos(angle)) / square, (angle - libm::sin(angle)) / (square * angle))
    };
    let cross = cross_matrix(r);
    DMat3::IDENTITY + cross * a + cross * cross * b
}

/// The matrix of `x -> v x x` (cross product).
fn cross_matrix(v: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, v.z, -v.y), DVec3::new(-v.z, 0.0, v.x), DVec3::new(v.y, -v.x, 0.0))
}

/// The derivatives of the nine entries of R, row by row, by the small rotation about each axis.
fn entry_derivatives(rotation: DMat3) -> [[f64; 9]; 3] {
    [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| (cross_matrix(axis) * rotation).transpose().to_cols_array())
}

/// A joint in a pose.
#[derive(Debug, Clone, Copy)]
struct PosedJoint {
    /// World from the parent's axes.
    parent_rotation: DMat3,
    /// Where the joint is, metres.
    position: DVec3,
    /// Rotation relative to the parent.
    local: DMat3,
    /// Transform of points that follow the joint: `rotation * rest + translation`.
    rotation: DMat3,
    translation: DVec3,
}

impl PosedJoint {
    /// The joints with these parents, rest positions and rotations relative to their parents.
    fn chain(
        parents: impl Iterator<Item = Option<usize>>,
        rest: &[DVec3],
        local: impl Fn(usize) -> DQuat,
        translation: DVec3,
    ) -> Vec<Self> {
        let mut chain: Vec<Self> = Vec::with_capacity(rest.len());
        for (joint, (parent, &rest)) in parents.zip(rest).enumerate() {
            let (parent_rotation, parent_translation) = parent
                .map_or((DMat3::IDENTITY, translation), |parent| {
                    (chain[parent].rotation, chain[parent].translation)
                });
            let local = DMat3::from_quat(local(joint));
            let rotation = parent_rotation * local;
            let position = parent_rotation * rest + parent_translation;
            let translation = position - rotation * rest;
            chain.push(Self { parent_rotation, position, local, rotation, translation });
        }
        chain
    }

    fn point(&self, rest: DVec3) -> DVec3 {
        self.rotation * rest + self.translation
    }
}
