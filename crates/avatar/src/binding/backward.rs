//! From the gradients of Gaussians in the world to those of the bound ones, of the triangles' frames, and of the vertices.

use glam::{Quat, Vec3, Vec4};
use rayon::prelude::*;
use srflow_head::{TriangleFrame, TriangleFrameGradient};
use srflow_splat::GaussianGradients;

use super::BoundGaussians;

/// Gradients of a loss with respect to bound Gaussians, and to the frames that they are bound to. Opacities and spherical
/// harmonics are the same in the world, and so are their gradients.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BoundGradients {
    /// Of the local positions.
    pub positions: Vec<Vec3>,
    /// Of the local scales.
    pub scales: Vec<Vec3>,
    /// Of the local rotations: `x, y, z, w` of the quaternions as they are stored.
    pub rotations: Vec<Vec4>,
    /// One for each triangle of the model.
    pub frames: Vec<TriangleFrameGradient>,
    /// What each Gaussian adds to its frame.
    shares: Vec<TriangleFrameGradient>,
}

impl BoundGaussians {
    /// Writes the gradients of the bound Gaussians and of `frames`, given those of the Gaussians in the world. Sums are taken in
    /// the order of the Gaussians, for any number of threads.
    ///
    /// Panics when `frames` are not those of every triangle, or `world` not the gradients of as many Gaussians.
    pub fn backward(&self, frames: &[TriangleFrame], world: &GaussianGradients, out: &mut BoundGradients) {
        assert_eq!(world.positions.len(), self.len(), "gradients of other Gaussians");
        let BoundGradients { positions, scales, rotations, frames: frame_gradients, shares } = out;
        const CHUNK: usize = 4096;
        positions.resize(self.len(), Vec3::ZERO);
        scales.resize(self.len(), Vec3::ZERO);
        rotations.resize(self.len(), Vec4::ZERO);
        shares.resize(self.len(), TriangleFrameGradient::default());
        positions
            .par_chunks_mut(CHUNK)
            .zip(scales.par_chunks_mut(CHUNK))
            .zip(rotations.par_chunks_mut(CHUNK))
            .zip(shares.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, (((positions, scales), rotations), shares))| {
                let lists = positions.iter_mut().zip(scales).zip(rotations).zip(shares);
                for (j, (((position, scale), rotation), share)) in lists.enumerate() {
                    let i = chunk * CHUNK + j;
                    let frame = &frames[self.triangles[i] as usize];
                    let world = (world.positions[i], world.scales[i], world.rotations[i]);
                    (*position, *scale, *rotation, *share) = self.one_backward(i, frame, world);
                }
            });
        frame_gradients.clear();
        frame_gradients.resize(frames.len(), TriangleFrameGradient::default());
        for (&triangle, share) in self.triangles.iter().zip(&*shares) {
            let total = &mut frame_gradients[triangle as usize];
            total.origin += share.origin;
            total.rotation += share.rotation;
            total.scale += share.scale;
        }
    }

    /// The backward of [`BoundGaussians::world`]: of the local position, scale and rotation, and of the frame.
    fn one_backward(
        &self,
        i: usize,
        frame: &TriangleFrame,
        (position, scale, rotation): (Vec3, Vec3, Vec4),
    ) -> (Vec3, Vec3, Vec4, TriangleFrameGradient) {
        let (local_position, local_scale) = (self.local.positions[i], self.local.scales[i]);
        let offset = frame.rotation * local_position;
        let rotation = Quat::from_vec4(rotation);
        // Multiplying by a unit quaternion keeps inner products, and multiplying from the right by one of any length is undone
        // by its conjugate. A small turn of the frame adds half of its product with the world rotation.
        let world_rotation = frame.rotation * self.local.rotations[i];
        let turn = 0.5 * (rotation * world_rotation.conjugate()).xyz();
        let share = TriangleFrameGradient {
            origin: position,
            rotation: frame.scale * offset.cross(position) + turn,
            scale: offset.dot(position) + local_scale.dot(scale),
        };
        (
            frame.scale * (frame.rotation.conjugate() * position),
            frame.scale * scale,
            Vec4::from(frame.rotation.conjugate() * rotation),
            share,
        )
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DQuat, DVec3, DVec4};
    use srflow_core::random::{Key, Stream};
    use srflow_head::vertex_gradients;
    use srflow_splat::Gaussians;

    use super::*;

    fn vector(stream: &mut Stream) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| f64::from(stream.normal())))
    }

    /// Vertices of a triangle and a Gaussian bound to it, as 19 numbers.
    #[derive(Clone)]
    struct Bound {
        vertices: [DVec3; 3],
        position: DVec3,
        scale: DVec3,
        rotation: DVec4,
    }

    impl Bound {
        fn number(&mut self, i: usize) -> &mut f64 {
            match i {
                0..9 => &mut self.vertices[i / 3][i % 3],
                9..12 => &mut self.position[i - 9],
                12..15 => &mut self.scale[i - 12],
                _ => &mut self.rotation[i - 15],
            }
        }

        /// The frame as GaussianAvatars defines it, in `f64`; the sign of its quaternion is nearest to `like`.
        fn frame(&self, like: DQuat) -> (DVec3, DQuat, f64) {
            let [v0, v1, v2] = self.vertices;
            let a0 = (v1 - v0).normalize();
            let a1 = a0.cross(v2 - v0).normalize();
            let a2 = -(a1.cross(a0).normalize());
            let rotation = DQuat::from_mat3(&DMat3::from_cols(a0, a1, a2));
            let rotation = if rotation.dot(like) < 0.0 { -rotation } else { rotation };
            ((v0 + v1 + v2) / 3.0, rotation, ((v1 - v0).length() + a2.dot(v2 - v0).abs()) / 2.0)
        }

        /// A loss of the Gaussian in the world, with these gradients.
        fn loss(&self, like: DQuat, (position, scale, rotation): (DVec3, DVec3, DVec4)) -> f64 {
            let (origin, turn, size) = self.frame(like);
            let world = turn * DQuat::from_vec4(self.rotation);
            position.dot(size * (turn * self.position) + origin)
                + scale.dot(size * self.scale)
                + rotation.dot(DVec4::from(world))
        }
    }

    #[test]
    fn gradients_match_central_differences() {
        let mut stream = Key::new(5).stream("binding");
        for round in 0..100 {
            let mut bound = Bound {
                vertices: std::array::from_fn(|_| vector(&mut stream)),
                position: vector(&mut stream),
                scale: vector(&mut stream).abs(),
                rotation: vector(&mut stream).extend(1.0),
            };
            // The kernel's inputs are f32.
            (0..19).for_each(|i| *bound.number(i) = f64::from(*bound.number(i) as f32));
            let gradient = (vector(&mut stream), vector(&mut stream), vector(&mut stream).extend(0.7));

            let corners = bound.vertices.map(|vertex| vertex.as_vec3());
            let frame = TriangleFrame::of(corners[0], corners[1], corners[2]);
            let local = Gaussians {
                positions: vec![bound.position.as_vec3()],
                scales: vec![bound.scale.as_vec3()],
                rotations: vec![Quat::from_vec4(bound.rotation.as_vec4())],
                opacities: vec![1.0],
                sh: vec![[0.0; 3]],
                sh_degree: 0,
                antialiased: false,
            };
            let world = GaussianGradients {
                positions: vec![gradient.0.as_vec3()],
                scales: vec![gradient.1.as_vec3()],
                rotations: vec![gradient.2.as_vec4()],
                ..GaussianGradients::default()
            };
            let mut out = BoundGradients::default();
            BoundGaussians::new(local, vec![0], 1).unwrap().backward(&[frame], &world, &mut out);
            let mut vertices = Vec::new();
            vertex_gradients(&[[0, 1, 2]], &corners, &out.frames, &mut vertices);
            let mut found: Vec<f32> = vertices.iter().flat_map(|vertex| vertex.to_array()).collect();
            found.extend(out.positions[0].to_array());
            found.extend(out.scales[0].to_array());
            found.extend(out.rotations[0].to_array());

            let like = frame.rotation.as_dquat();
            let expected: Vec<f64> = (0..19)
                .map(|i| {
                    let at = |step: f64| {
                        let mut bound = bound.clone();
                        *bound.number(i) += step;
                        bound.loss(like, gradient)
                    };
                    (at(1e-6) - at(-1e-6)) / 2e-6
                })
                .collect();
            // Those of a sliver's vertices are large and cancel.
            let size = expected.iter().fold(1.0_f64, |size, value| size.max(value.abs()));
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let error = (f64::from(*found) - expected).abs();
                assert!(error < 3e-5 * size, "round {round}, number {i}: {found}, by differences {expected}");
            }
        }
    }

    #[test]
    fn a_frame_gets_the_sum_over_its_gaussians_for_any_number_of_threads() {
        let mut stream = Key::new(6).stream("binding");
        let (count, triangles) = (10_000, 7);
        let mut small = || vector(&mut stream).as_vec3();
        let frames: Vec<TriangleFrame> =
            (0..triangles).map(|_| TriangleFrame::of(small(), small(), small())).collect();
        let local = Gaussians {
            positions: (0..count).map(|_| small()).collect(),
            scales: (0..count).map(|_| small().abs()).collect(),
            rotations: (0..count).map(|_| Quat::from_scaled_axis(small())).collect(),
            opacities: vec![1.0; count],
            sh: vec![[0.0; 3]; count],
            sh_degree: 0,
            antialiased: false,
        };
        let world = GaussianGradients {
            positions: (0..count).map(|_| small()).collect(),
            scales: (0..count).map(|_| small()).collect(),
            rotations: (0..count).map(|_| small().extend(0.1)).collect(),
            ..GaussianGradients::default()
        };
        let numbers = (0..count as u32).map(|i| i * 5 % triangles as u32).collect();
        let bound = BoundGaussians::new(local, numbers, triangles).unwrap();
        let found = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut out = BoundGradients::default();
            pool.install(|| bound.backward(&frames, &world, &mut out));
            out
        });
        assert!(found[0] == found[1] && found[1] == found[2]);
        let origin: Vec3 = (0..count).filter(|i| i * 5 % triangles == 3).map(|i| world.positions[i]).sum();
        assert!(found[0].frames[3].origin.distance(origin) < 1e-2);
        assert_eq!(found[0].frames.len(), triangles);
    }
}
