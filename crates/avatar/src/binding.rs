use glam::{Mat3, Quat, Vec3};
use rayon::prelude::*;
use srflow_splat::Gaussians;

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
    /// The frame of a triangle. A triangle without area keeps a valid rotation: its missing axes are chosen freely.
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
}

/// One Gaussian in world units, before it is bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Splat {
    pub position: Vec3,
    pub scale: Vec3,
    pub rotation: Quat,
    pub opacity: f32,
    /// sRGB, `0..=1`.
    pub color: Vec3,
}

/// Gaussians in the local frames of triangles. They ride on the triangles: position, scale and rotation.
#[derive(Debug, Clone, Default)]
pub struct BoundGaussians {
    triangles: Vec<u32>,
    local: Gaussians,
}

/// Degree-0 spherical-harmonics basis function.
const SH_0: f32 = 0.282_094_79;

impl BoundGaussians {
    /// How many Gaussians there are.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The triangle that each Gaussian rides on.
    pub fn triangles(&self) -> &[u32] {
        &self.triangles
    }

    /// Binds a Gaussian to triangle number `triangle`, whose frame at rest is `frame`.
    pub(crate) fn bind(&mut self, triangle: u32, frame: &TriangleFrame, splat: &Splat) {
        let unit = if frame.scale > 0.0 { frame.scale.recip() } else { 0.0 };
        self.triangles.push(triangle);
        self.local.positions.push(frame.local_from_world(splat.position));
        self.local.scales.push(splat.scale * unit);
        self.local.rotations.push((frame.rotation.inverse() * splat.rotation).normalize());
        self.local.opacities.push(splat.opacity);
        self.local.sh.push(((splat.color - 0.5) / SH_0).to_array());
    }

    /// World Gaussian number `i` on a triangle in `frame`: `x' = k R x + T`, `scale' = k scale`, `q' = q_R q`. This is
    /// the definition; [`Self::world_into`] does the same for all of them at once.
    pub fn world(&self, i: usize, frame: &TriangleFrame) -> (Vec3, Vec3, Quat) {
        (
            frame.point(self.local.positions[i]),
            self.local.scales[i] * frame.scale,
            frame.rotation * self.local.rotations[i],
        )
    }

    /// Writes all Gaussians in world units, on the frames of the model's triangles as they are now.
    ///
    /// `out` is resized and overwritten; its memory is used again from frame to frame.
    pub(crate) fn world_into(&self, frames: &[TriangleFrame], out: &mut Gaussians) {
        let n = self.len();
        out.sh_degree = 0;
        out.positions.resize(n, Vec3::ZERO);
        out.scales.resize(n, Vec3::ZERO);
        out.rotations.resize(n, Quat::IDENTITY);
        out.opacities.clone_from(&self.local.opacities);
        out.sh.clone_from(&self.local.sh);
        const CHUNK: usize = 8192;
        out.positions
            .par_chunks_mut(CHUNK)
            .zip(out.scales.par_chunks_mut(CHUNK))
            .zip(out.rotations.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, ((positions, scales), rotations))| {
                let start = chunk * CHUNK;
                for (j, ((position, scale), rotation)) in
                    positions.iter_mut().zip(scales).zip(rotations).enumerate()
                {
                    let i = start + j;
                    let frame = &frames[self.triangles[i] as usize];
                    (*position, *scale, *rotation) = self.world(i, frame);
                }
            });
    }
}
