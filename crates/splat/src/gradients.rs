use glam::{DVec3, Vec2, Vec3, Vec4};
use srflow_core::Size;

use crate::{Gaussians, RasterizeError};

/// Gradients of a loss with respect to the outputs of a rendering: lists as long as the frame has pixels, row-major. An empty
/// list stands for zeros.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameGradients {
    /// Of [`Frame::color`](crate::Frame::color), the colour before clamping.
    pub color: Vec<[f32; 3]>,
    /// Of [`Frame::alpha`](crate::Frame::alpha).
    pub alpha: Vec<f32>,
    /// Of [`Frame::depth`](crate::Frame::depth).
    pub depth: Vec<f32>,
    /// Of [`Frame::flow`](crate::Frame::flow).
    pub flow: Vec<[f32; 2]>,
    /// Of [`Frame::depth_next`](crate::Frame::depth_next).
    pub depth_next: Vec<f32>,
}

impl FrameGradients {
    /// Checks the length of each list, for an image of this size.
    pub(crate) fn validate(&self, size: Size) -> Result<(), RasterizeError> {
        let lists = [
            ("color", self.color.len()),
            ("alpha", self.alpha.len()),
            ("depth", self.depth.len()),
            ("flow", self.flow.len()),
            ("depth_next", self.depth_next.len()),
        ];
        for (list, found) in lists {
            if found != 0 && found != size.pixels() {
                return Err(RasterizeError::GradientLength { list, found, size });
            }
        }
        Ok(())
    }
}

/// Gradient of a loss with respect to a camera.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraGradient {
    /// With respect to a translation after [`Camera::camera_from_world`](crate::Camera::camera_from_world), in camera axes and
    /// per world unit.
    pub translation: DVec3,
    /// With respect to a rotation after it: around the camera's axes and origin, per radian.
    pub rotation: DVec3,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
}

impl std::ops::AddAssign for CameraGradient {
    fn add_assign(&mut self, other: Self) {
        self.translation += other.translation;
        self.rotation += other.rotation;
        self.fx += other.fx;
        self.fy += other.fy;
        self.cx += other.cx;
        self.cy += other.cy;
    }
}

/// Gradients of a loss with respect to everything that a rendering depends on: lists as long as those of the [`Gaussians`].
/// They are zero for a Gaussian that is not visible.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GaussianGradients {
    pub positions: Vec<Vec3>,
    pub scales: Vec<Vec3>,
    /// `x, y, z, w` of the quaternions as they are stored: the rendering normalises them, so these are perpendicular to them.
    pub rotations: Vec<Vec4>,
    pub opacities: Vec<f32>,
    pub sh: Vec<[f32; 3]>,
    /// Of the moved positions; empty without a next frame.
    pub next_positions: Vec<Vec3>,
    /// Of the centres on the image, in pixels, through the blending weights alone: what adaptive density control of 3DGS
    /// measures. (The reference measures it in normalised device coordinates: times half of the image's width and height.)
    pub centers: Vec<Vec2>,
    /// The same with the sum over pixels taken of absolute values, as in AbsGS (Ye et al. 2024).
    pub centers_absolute: Vec<Vec2>,
    pub camera: CameraGradient,
    /// Zero without a next frame.
    pub next_camera: CameraGradient,
}

impl GaussianGradients {
    /// Resizes the lists; their contents are unspecified.
    pub(crate) fn prepare(&mut self, gaussians: &Gaussians, motion: bool) {
        let n = gaussians.len();
        self.positions.resize(n, Vec3::ZERO);
        self.scales.resize(n, Vec3::ZERO);
        self.rotations.resize(n, Vec4::ZERO);
        self.opacities.resize(n, 0.0);
        self.sh.resize(n * gaussians.sh_len(), [0.0; 3]);
        self.next_positions.resize(if motion { n } else { 0 }, Vec3::ZERO);
        self.centers.resize(n, Vec2::ZERO);
        self.centers_absolute.resize(n, Vec2::ZERO);
    }

    /// The lists in parts of `size` Gaussians (the last may be smaller) of `sh_len` coefficients each.
    pub(crate) fn chunks(&mut self, size: usize, sh_len: usize) -> Vec<GaussianGradientsChunk<'_>> {
        let mut next_positions = self.next_positions.chunks_mut(size);
        self.positions
            .chunks_mut(size)
            .zip(self.scales.chunks_mut(size))
            .zip(self.rotations.chunks_mut(size))
            .zip(self.opacities.chunks_mut(size))
            .zip(self.sh.chunks_mut(size * sh_len))
            .zip(self.centers.chunks_mut(size).zip(self.centers_absolute.chunks_mut(size)))
            .map(|(((((positions, scales), rotations), opacities), sh), (centers, centers_absolute))| {
                GaussianGradientsChunk {
                    positions,
                    scales,
                    rotations,
                    opacities,
                    sh,
                    next_positions: next_positions.next().unwrap_or_default(),
                    centers,
                    centers_absolute,
                }
            })
            .collect()
    }
}

/// A part of [`GaussianGradients`], written by one thread.
pub(crate) struct GaussianGradientsChunk<'a> {
    pub positions: &'a mut [Vec3],
    pub scales: &'a mut [Vec3],
    pub rotations: &'a mut [Vec4],
    pub opacities: &'a mut [f32],
    pub sh: &'a mut [[f32; 3]],
    /// Empty without a next frame.
    pub next_positions: &'a mut [Vec3],
    pub centers: &'a mut [Vec2],
    pub centers_absolute: &'a mut [Vec2],
}

impl GaussianGradientsChunk<'_> {
    /// Writes zeros for one Gaussian.
    pub(crate) fn clear(&mut self, at: usize) {
        let sh_len = self.sh.len() / self.positions.len();
        self.positions[at] = Vec3::ZERO;
        self.scales[at] = Vec3::ZERO;
        self.rotations[at] = Vec4::ZERO;
        self.opacities[at] = 0.0;
        self.sh[at * sh_len..][..sh_len].fill([0.0; 3]);
        if let Some(next_position) = self.next_positions.get_mut(at) {
            *next_position = Vec3::ZERO;
        }
        self.centers[at] = Vec2::ZERO;
        self.centers_absolute[at] = Vec2::ZERO;
    }
}
