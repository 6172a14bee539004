mod backward;

use glam::{Quat, Vec3};
use rayon::prelude::*;
use srflow_head::{Splat, TriangleFrame};
use srflow_simd::{Isa, Simd, dispatch};
use srflow_splat::Gaussians;

use crate::train::{GaussianAdam, LearningRates, ParameterGradients};

pub use backward::BoundGradients;

/// Gaussians cannot be bound to the triangles of a model.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BindingError {
    /// Not one triangle per Gaussian.
    #[error("{gaussians} Gaussians, but {bound} triangles that they are bound to; each needs one")]
    Count { gaussians: usize, bound: usize },
    /// A triangle that the model does not have.
    #[error(
        "Gaussian {gaussian} is bound to triangle {triangle}, but the head model has {count} triangles; the avatar belongs to \
         another model (FLAME has 9976, with the teeth of GaussianAvatars 10144)"
    )]
    Triangle { gaussian: usize, triangle: u32, count: usize },
}

/// Gaussians in the local frames of triangles: position, scale and rotation follow the triangle.
#[derive(Debug, Clone, Default)]
pub struct BoundGaussians {
    triangles: Vec<u32>,
    local: Gaussians,
}

/// Degree-0 spherical-harmonics basis function.
const SH_0: f32 = 0.282_094_79;

impl BoundGaussians {
    /// Gaussians in the local frames of `triangles`, one each.
    ///
    /// # Errors
    /// When there is not one triangle per Gaussian, or one is not of the `count` triangles of the model.
    pub fn new(local: Gaussians, triangles: Vec<u32>, count: usize) -> Result<Self, BindingError> {
        if triangles.len() != local.len() {
            return Err(BindingError::Count { gaussians: local.len(), bound: triangles.len() });
        }
        match triangles.iter().position(|&triangle| triangle as usize >= count) {
            None => Ok(Self { triangles, local }),
            Some(gaussian) => Err(BindingError::Triangle { gaussian, triangle: triangles[gaussian], count }),
        }
    }

    /// The Gaussians in the local frames of their triangles.
    pub fn local(&self) -> &Gaussians {
        &self.local
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The triangle that each Gaussian is bound to.
    pub fn triangles(&self) -> &[u32] {
        &self.triangles
    }

    /// Binds a Gaussian to triangle number `triangle`, whose rest frame is `frame`.
    pub(crate) fn bind(&mut self, triangle: u32, frame: &TriangleFrame, splat: &Splat) {
        let unit = if frame.scale > 0.0 { frame.scale.recip() } else { 0.0 };
        self.triangles.push(triangle);
        self.local.positions.push(frame.local_from_world(splat.position));
        self.local.scales.push(splat.scale * unit);
        self.local.rotations.push((frame.rotation.inverse() * splat.rotation).normalize());
        self.local.opacities.push(splat.opacity);
        self.local.sh.push(((splat.color - 0.5) / SH_0).to_array());
    }

    /// World Gaussian number `i` on a triangle in `frame`: `x' = k R x + T`, `scale' = k scale`, `q' = q_R q`. This is the
    /// definition; `world_into` computes all of them at once.
    #[inline(always)]
    pub fn world(&self, i: usize, frame: &TriangleFrame) -> (Vec3, Vec3, Quat) {
        (
            frame.point(self.local.positions[i]),
            self.local.scales[i] * frame.scale,
            frame.rotation * self.local.rotations[i],
        )
    }

    /// Moves the local Gaussians by one step of Adam; see [`GaussianAdam::step`].
    pub fn step(
        &mut self,
        adam: &mut GaussianAdam,
        gradients: ParameterGradients<'_>,
        rates: &LearningRates,
    ) {
        adam.step(&mut self.local, gradients, rates);
    }

    /// Replaces the Gaussians by copies of their `parents` on the same triangles; see [`GaussianAdam::inherit`].
    pub(crate) fn inherit(&mut self, adam: &mut GaussianAdam, parents: &[u32], survivors: usize) {
        self.triangles = parents.iter().map(|&parent| self.triangles[parent as usize]).collect();
        adam.inherit(&mut self.local, parents, survivors);
    }

    /// The Gaussians in the local frames of their triangles. Their number must stay.
    pub(crate) fn local_mut(&mut self) -> &mut Gaussians {
        &mut self.local
    }

    /// Writes all Gaussians in world units, for the current frames of the model's triangles. Panics when a frame is missing.
    ///
    /// `out` is resized and overwritten, and keeps its memory between frames.
    pub fn world_into(&self, frames: &[TriangleFrame], out: &mut Gaussians) {
        let n = self.len();
        out.sh_degree = self.local.sh_degree;
        out.antialiased = self.local.antialiased;
        out.positions.resize(n, Vec3::ZERO);
        out.scales.resize(n, Vec3::ZERO);
        out.rotations.resize(n, Quat::IDENTITY);
        out.opacities.clone_from(&self.local.opacities);
        out.sh.clone_from(&self.local.sh);
        const CHUNK: usize = 8192;
        let isa = Isa::best();
        out.positions
            .par_chunks_mut(CHUNK)
            .zip(out.scales.par_chunks_mut(CHUNK))
            .zip(out.rotations.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, ((positions, scales), rotations))| {
                world_chunk(isa, self, frames, chunk * CHUNK, positions, scales, rotations);
            });
    }
}

dispatch! {
    /// [`BoundGaussians::world`] of the Gaussians from number `start` on.
    fn world_chunk = world_kernel(
        bound: &BoundGaussians,
        frames: &[TriangleFrame],
        start: usize,
        positions: &mut [Vec3],
        scales: &mut [Vec3],
        rotations: &mut [Quat],
    )
}

#[inline(always)]
fn world_kernel<S: Simd>(
    s: S,
    bound: &BoundGaussians,
    frames: &[TriangleFrame],
    start: usize,
    positions: &mut [Vec3],
    scales: &mut [Vec3],
    rotations: &mut [Quat],
) {
    /// Frames are fetched so many Gaussians ahead: they lie anywhere, and another thread may have written them.
    const AHEAD: usize = 16;
    let moved = positions.iter_mut().zip(scales).zip(rotations);
    for (i, ((position, scale), rotation)) in (start..).zip(moved) {
        if let Some(&ahead) = bound.triangles.get(i + AHEAD) {
            s.prefetch(&frames[ahead as usize]);
        }
        let frame = &frames[bound.triangles[i] as usize];
        (*position, *scale, *rotation) = bound.world(i, frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use srflow_core::random::{Key, Stream};

    fn vector(stream: &mut Stream) -> Vec3 {
        Vec3::new(stream.normal(), stream.normal(), stream.normal())
    }

    /// GaussianAvatars, `utils/graphics_utils.py` and `scene/gaussian_model.py`, transcribed in f64: centroid,
    /// a0 = norm(v1 - v0), a1 = norm(a0 x (v2 - v0)), a2 = -norm(a1 x a0), R = [a0 | a1 | a2],
    /// k = (|v1 - v0| + |a2 . (v2 - v0)|) / 2; x' = k R x + T, scale' = k scale, covariance axes R q.
    fn by_definition(v: [DVec3; 3], x: DVec3, scale: DVec3, q: DMat3) -> (DVec3, DVec3, DMat3) {
        let centroid = (v[0] + v[1] + v[2]) / 3.0;
        let a0 = (v[1] - v[0]).normalize();
        let a1 = a0.cross(v[2] - v[0]).normalize();
        let a2 = -(a1.cross(a0).normalize());
        let rotation = DMat3::from_cols(a0, a1, a2);
        let k = ((v[1] - v[0]).length() + a2.dot(v[2] - v[0]).abs()) / 2.0;
        (k * (rotation * x) + centroid, k * scale, rotation * q)
    }

    #[test]
    fn gaussians_follow_triangles_as_in_gaussian_avatars() {
        let mut stream = Key::new(3).stream("binding");
        for _ in 0..200 {
            let v: [Vec3; 3] = std::array::from_fn(|_| vector(&mut stream));
            let rest: [Vec3; 3] = std::array::from_fn(|_| vector(&mut stream));
            let mut bound = BoundGaussians::default();
            let splat = Splat {
                position: vector(&mut stream),
                scale: Vec3::new(0.1, 0.2, 0.3),
                rotation: Quat::from_scaled_axis(vector(&mut stream)),
                opacity: 0.5,
                color: Vec3::new(0.2, 0.5, 0.9),
            };
            bound.bind(0, &TriangleFrame::of(rest[0], rest[1], rest[2]), &splat);
            let frame = TriangleFrame::of(v[0], v[1], v[2]);
            let (position, scale, rotation) = bound.world(0, &frame);
            let local = DMat3::from_quat(bound.local.rotations[0].as_dquat());
            let x = bound.local.positions[0].as_dvec3();
            let expected = by_definition(v.map(|p| p.as_dvec3()), x, bound.local.scales[0].as_dvec3(), local);
            // Slivers have large local coordinates: the tolerance grows with them.
            let reach = 1.0 + f64::from(frame.scale) * x.length();
            assert!(position.as_dvec3().distance(expected.0) < 1e-5 * reach, "{position} {}", expected.0);
            assert!(scale.as_dvec3().distance(expected.1) < 1e-5 * (1.0 + expected.1.length()));
            let axes = DMat3::from_quat(rotation.as_dquat());
            assert!((axes - expected.2).to_cols_array().iter().all(|d| d.abs() < 1e-4));
            let (again, ..) = bound.world(0, &TriangleFrame::of(rest[0], rest[1], rest[2]));
            assert!(again.distance(splat.position) < 1e-3, "at rest a Gaussian is at its bound position");
        }
    }

    #[test]
    fn all_at_once_matches_one_by_one() {
        let mut stream = Key::new(4).stream("binding");
        let frames: Vec<TriangleFrame> = (0..50)
            .map(|_| TriangleFrame::of(vector(&mut stream), vector(&mut stream), vector(&mut stream)))
            .collect();
        let mut bound = BoundGaussians::default();
        for _ in 0..20_000 {
            let splat = Splat {
                position: vector(&mut stream),
                scale: vector(&mut stream).abs(),
                rotation: Quat::from_scaled_axis(vector(&mut stream)),
                opacity: stream.unit(),
                color: vector(&mut stream).abs(),
            };
            let triangle = stream.below(50);
            bound.bind(triangle, &frames[triangle as usize], &splat);
        }
        let mut out = Gaussians { positions: vec![Vec3::NAN; 7], ..Gaussians::default() };
        bound.world_into(&frames, &mut out);
        assert_eq!(out.len(), bound.len());
        for i in 0..bound.len() {
            let expected = bound.world(i, &frames[bound.triangles()[i] as usize]);
            assert_eq!((out.positions[i], out.scales[i], out.rotations[i]), expected);
        }
        assert_eq!(out.sh.len(), bound.len());
        assert_eq!(out.sh_degree, 0);
    }

    #[test]
    fn triangles_without_area_give_finite_gaussians() {
        let (p, q) = (Vec3::new(0.1, 0.2, 0.3), Vec3::new(0.4, 0.2, 0.3));
        let splat = Splat {
            position: p,
            scale: Vec3::splat(0.01),
            rotation: Quat::IDENTITY,
            opacity: 1.0,
            color: Vec3::ONE,
        };
        for [a, b, c] in [[p, p, p], [p, q, q], [p, p, q], [p, q, p], [p, q, p.lerp(q, 0.5)]] {
            let frame = TriangleFrame::of(a, b, c);
            let mut bound = BoundGaussians::default();
            bound.bind(0, &frame, &splat);
            let (position, scale, rotation) = bound.world(0, &frame);
            assert!(position.is_finite() && scale.is_finite() && rotation.is_normalized(), "{a} {b} {c}");
        }
    }
}
