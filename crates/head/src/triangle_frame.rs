//! The local frames of triangles, in which Gaussians follow a head.

use glam::{DVec3, Mat3, Quat, Vec3};

/// The local frame of a triangle in GaussianAvatars (Qian et al. 2024; `utils/graphics_utils.py`): origin at the
/// centroid, axes along the first edge, the normal and their cross product, unit length the mean of base and height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangleFrame {
    /// Centroid.
    pub origin: Vec3,
    /// World from local axes `[a0 | a1 | a2]`: a0 along the first edge, a1 the normal, a2 = -(a1 x a0).
    pub rotation: Quat,
    /// Metres per local unit: half of the first edge's length plus the height over it; 0 for a point.
    pub scale: f32,
}

impl TriangleFrame {
    /// The frame of a triangle. A degenerate triangle still gets a valid rotation: its missing axes are arbitrary.
    pub fn of(v0: Vec3, v1: Vec3, v2: Vec3) -> Self {
        let a0 = (v1 - v0).normalize_or(Vec3::X);
        let a1 = a0.cross(v2 - v0).try_normalize().unwrap_or_else(|| a0.any_orthonormal_vector());
        let a2 = a0.cross(a1);
        Self {
            origin: (v0 + v1 + v2) / 3.0,
            rotation: Quat::from_mat3(&Mat3::from_cols(a0, a1, a2)),
            scale: ((v1 - v0).length() + a2.dot(v2 - v0).abs()) * 0.5,
        }
    }

    /// World point of a local point: `k R x + T`.
    #[inline]
    pub fn point(&self, local: Vec3) -> Vec3 {
        self.rotation * (local * self.scale) + self.origin
    }

    /// Local point of a world point; the origin when the triangle is a point.
    pub fn local_from_world(&self, world: Vec3) -> Vec3 {
        if self.scale > 0.0 {
            (self.rotation.inverse() * (world - self.origin)) / self.scale
        } else {
            Vec3::ZERO
        }
    }

    /// The backward of [`TriangleFrame::of`]: the gradients of the three vertices. What a degenerate triangle leaves arbitrary
    /// has no gradient.
    pub fn backward([v0, v1, v2]: [Vec3; 3], gradient: &TriangleFrameGradient) -> [Vec3; 3] {
        /// Lengths under this have no direction in `f32`.
        const SMALLEST: f64 = 1e-18;
        let (edge, side) = ((v1 - v0).as_dvec3(), (v2 - v0).as_dvec3());
        let base = edge.length();
        let (mut of_edge, mut of_side) = (DVec3::ZERO, DVec3::ZERO);
        if base > SMALLEST {
            let a0 = edge / base;
            let normal = a0.cross(side);
            let height = normal.length();
            let (half, turn) = (0.5 * f64::from(gradient.scale), gradient.rotation.as_dvec3());
            of_edge = half * a0;
            if height > SMALLEST {
                // The side is `along a0 - height a2`. The triangle turns about a0 as the apex leaves its plane, about a1 and a2
                // as the edge turns.
                let a1 = normal / height;
                let a2 = a0.cross(a1);
                let along = side.dot(a0);
                let about_a0 = turn.dot(a0) / height;
                of_edge +=
                    (turn.dot(a2) - about_a0 * along) / base * a1 + (half * along - turn.dot(a1)) / base * a2;
                of_side = about_a0 * a1 - half * a2;
            }
        }
        let third = gradient.origin.as_dvec3() / 3.0;
        [third - of_edge - of_side, third + of_edge, third + of_side].map(|vertex| vertex.as_vec3())
    }
}

/// Gradient of a loss with respect to a [`TriangleFrame`].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TriangleFrameGradient {
    /// Per metre.
    pub origin: Vec3,
    /// With respect to a rotation around the origin, about the world's axes and after [`TriangleFrame::rotation`]; per radian.
    pub rotation: Vec3,
    pub scale: f32,
}

/// Writes the gradient of every vertex, given those of the frames of `triangles`.
///
/// Panics when there is not one frame for each triangle, or a triangle has a vertex that is not in `vertices`.
pub fn vertex_gradients(
    triangles: &[[u32; 3]],
    vertices: &[Vec3],
    frames: &[TriangleFrameGradient],
    out: &mut Vec<Vec3>,
) {
    assert_eq!(triangles.len(), frames.len(), "frames of other triangles");
    out.clear();
    out.resize(vertices.len(), Vec3::ZERO);
    for (triangle, frame) in triangles.iter().zip(frames) {
        if *frame == TriangleFrameGradient::default() {
            continue;
        }
        let corners = triangle.map(|vertex| vertices[vertex as usize]);
        for (&vertex, gradient) in triangle.iter().zip(TriangleFrame::backward(corners, frame)) {
            out[vertex as usize] += gradient;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degenerate_triangles_have_finite_gradients() {
        let (p, q) = (Vec3::new(0.1, 0.2, 0.3), Vec3::new(0.4, 0.2, 0.3));
        let gradient = TriangleFrameGradient { origin: Vec3::ONE, rotation: Vec3::ONE, scale: 1.0 };
        for corners in [[p, p, p], [p, q, q], [p, p, q], [p, q, p], [p, q, p.lerp(q, 0.5)]] {
            let found = TriangleFrame::backward(corners, &gradient);
            assert!(found.iter().all(|vertex| vertex.is_finite()), "{corners:?}: {found:?}");
            let sum: Vec3 = found.into_iter().sum();
            assert!(sum.distance(Vec3::ONE) < 1e-2 * found[0].length().max(1.0), "{corners:?}: {found:?}");
        }
    }
}
