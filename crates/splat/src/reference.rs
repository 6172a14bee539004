//! The definition of the rasterizer's output, in `f64`, one pixel at a time.
//!
//! The constants and the order of decisions are those of the 3DGS reference (graphdeco-inria/diff-gaussian-rasterization,
//! `cuda_rasterizer/forward.cu` and `auxiliary.h`), with three differences:
//!
//! - A Gaussian reaches every pixel at which its alpha is at least 1/255. The reference also requires the pixel to be in a
//!   16x16 tile that the Gaussian's 3-sigma square touches, so there a pixel's colour depends on the tile grid: an opaque
//!   Gaussian's rim between 3 and 3.3 sigma (alpha up to 2.8/255) is drawn in some tiles and cut off in others.
//! - The direction clamp of the projection's Jacobian, 1.3 times the half field of view in the reference, is generalized for
//!   an off-centre principal point: the image's own border plus 0.3 times the half field of view on each side. For a centred
//!   one it is the same.
//! - Quaternions are normalised, and arithmetic is `f64` (except for the sort key, which is `f32` in both).
//!
//! A Gaussian is not drawn when its centre's depth is at most [`NEAR`], its opacity is under 1/255, its quaternion has length
//! zero, or any of its parameters is not finite.
//!
//! With [`Gaussians::antialiased`] the opacity is that after the reduction, for this decision too. The factor is gsplat's (`add_blur`
//! in `gsplat/cuda/include/Utils.cuh`), zero for a Gaussian that is flat and seen from its edge; the 3DGS reference limits it to at
//! least 0.005.

mod backward;
#[cfg(test)]
mod tests;

use glam::{DMat3, DQuat, DVec2, DVec3};

pub use backward::{Gradients, backward};

use crate::{Camera, Gaussians, NEAR, Next, Options, RasterizeError, Sorting, sh};

/// Added to the diagonal of the projected covariance, px^2: every Gaussian is at least about a pixel wide.
pub const LOW_PASS: f64 = 0.3;
/// Maximum alpha of a Gaussian at a pixel: 0.99 as `f32`, as in the reference. Two such leave a transmittance just under
/// [`TRANSMITTANCE_MIN`], so the rounding of this constant matters.
pub const ALPHA_MAX: f64 = 0.99_f32 as f64;
/// Smaller alphas are skipped.
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// A pixel is done before the Gaussian that would reduce its transmittance below this.
pub const TRANSMITTANCE_MIN: f64 = 1e-4_f32 as f64;

/// One pixel of a rendering; see [`Frame`](crate::Frame) for the meaning of each.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pixel {
    /// Colour before clamping.
    pub color: [f64; 3],
    /// Sum of weights.
    pub alpha: f64,
    /// Expected depth.
    pub depth: f64,
    /// Sum of weighted displacements, pixels.
    pub flow: [f64; 2],
    /// Expected depth after the motion.
    pub depth_next: f64,
    /// Number of blended Gaussians.
    pub blended: u32,
}

/// Everything that a rendering depends on, in `f64`.
#[derive(Debug, Clone)]
struct Scene {
    positions: Vec<DVec3>,
    scales: Vec<DVec3>,
    rotations: Vec<DQuat>,
    opacities: Vec<f64>,
    sh_degree: usize,
    sh: Vec<[f64; 3]>,
    camera: Camera,
    /// The moved positions and the next camera.
    next: Option<(Vec<DVec3>, Camera)>,
    options: Options,
    antialiased: bool,
}

/// A Gaussian on the image plane.
#[derive(Debug, Clone, Copy)]
struct Splat {
    /// Index of the Gaussian.
    index: usize,
    center: DVec2,
    /// Inverse of the projected covariance: xx, xy, yy.
    conic: [f64; 3],
    /// Reduced if antialiased.
    opacity: f64,
    color: [f64; 3],
    depth: f64,
    displacement: DVec2,
    depth_next: f64,
    peak: Peak,
}

/// Where a Gaussian, low-pass filtered in space, is densest along rays; see [`Sorting::PerPixel`].
#[derive(Debug, Clone, Copy)]
struct Peak {
    /// The Gaussian's centre in camera coordinates.
    center: DVec3,
    /// The Gaussian's axes in camera coordinates, each of length 1.
    axes: DMat3,
    /// Along the axes, filter included.
    variances: DVec3,
}

impl Peak {
    fn new(camera: &Camera, center: DVec3, rotation: DQuat, scale: DVec3) -> Self {
        let axes = DMat3::from_mat4(camera.camera_from_world) * DMat3::from_quat(rotation.normalize());
        let filter = LOW_PASS * center.z * center.z / (camera.fx * camera.fy);
        Self { center, axes, variances: scale * scale + filter }
    }

    /// Camera z of the densest point of the ray through the pixel at `at`: `d . C m / d . C d` for the direction `d` with a z of
    /// 1, the centre `m` and the inverse of the filtered covariance `C`.
    fn depth(&self, camera: &Camera, at: DVec2) -> f64 {
        let direction = DVec3::new((at.x - camera.cx) / camera.fx, (at.y - camera.cy) / camera.fy, 1.0);
        let (direction, center) = (self.axes.transpose() * direction, self.axes.transpose() * self.center);
        (direction / self.variances).dot(center) / (direction / self.variances).dot(direction)
    }
}

/// Renders row-major pixels, each independently: time grows with pixels times Gaussians.
///
/// # Errors
/// As [`Rasterizer::render`](crate::Rasterizer::render).
pub fn render(
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
    options: &Options,
) -> Result<Vec<Pixel>, RasterizeError> {
    Ok(Scene::new(gaussians, camera, next, options)?.render())
}

impl Scene {
    fn new(
        gaussians: &Gaussians,
        camera: &Camera,
        next: Option<Next<'_>>,
        options: &Options,
    ) -> Result<Self, RasterizeError> {
        crate::options::validate(gaussians, camera, next)?;
        let positions = |set: &Gaussians| set.positions.iter().map(|position| position.as_dvec3()).collect();
        Ok(Self {
            positions: positions(gaussians),
            scales: gaussians.scales.iter().map(|scale| scale.as_dvec3()).collect(),
            rotations: gaussians.rotations.iter().map(|rotation| rotation.as_dquat()).collect(),
            opacities: gaussians.opacities.iter().copied().map(f64::from).collect(),
            sh_degree: gaussians.sh_degree,
            sh: gaussians.sh.iter().map(|coefficient| coefficient.map(f64::from)).collect(),
            camera: *camera,
            next: next.map(|next| (positions(next.gaussians), *next.camera)),
            options: *options,
            antialiased: gaussians.antialiased,
        })
    }

    fn render(&self) -> Vec<Pixel> {
        let splats = self.splats();
        self.places().map(|at| self.blend(&splats, at)).collect()
    }

    /// The visible Gaussians, front to back.
    fn splats(&self) -> Vec<Splat> {
        let mut splats: Vec<Splat> = (0..self.positions.len()).filter_map(|i| self.project(i)).collect();
        splats.sort_by(|a, b| (a.depth as f32).total_cmp(&(b.depth as f32))); // stable: equal depths keep their order
        splats
    }

    /// The pixels' centres, row-major.
    fn places(&self) -> impl Iterator<Item = DVec2> {
        let Camera { width, height, .. } = self.camera;
        (0..height).flat_map(move |y| (0..width).map(move |x| DVec2::new(x as f64, y as f64)))
    }

    /// The spherical-harmonics coefficients of a Gaussian.
    fn sh(&self, index: usize) -> &[[f64; 3]] {
        let each = sh::coefficients(self.sh_degree);
        &self.sh[index * each..][..each]
    }

    fn project(&self, index: usize) -> Option<Splat> {
        let position = self.positions[index];
        let scale = self.scales[index];
        let rotation = self.rotations[index];
        let opacity = self.opacities[index];
        let sh = self.sh(index);
        let finite = position.is_finite()
            && scale.is_finite()
            && rotation.is_finite()
            && opacity.is_finite()
            && sh.as_flattened().iter().all(|c| c.is_finite());
        let point = self.camera.camera_from_world.transform_point3(position);
        if !finite || rotation.length() == 0.0 || opacity < ALPHA_MIN || point.z <= NEAR {
            return None;
        }
        let projection = projection(&self.camera, point, world_from_axes(rotation, scale));
        let opacity = if self.antialiased { opacity * compensation(&projection) } else { opacity };
        if opacity < ALPHA_MIN {
            return None;
        }
        let center = self.camera.pixel(point);
        let (displacement, depth_next) = self.motion(index, center);
        Some(Splat {
            index,
            center,
            conic: inverse(covariance(&projection)),
            opacity,
            color: sh::color(self.sh_degree, sh, position - self.camera.position()),
            depth: point.z,
            displacement,
            depth_next,
            peak: Peak::new(&self.camera, point, rotation, scale),
        })
    }

    /// Displacement of the projected centre in pixels of the convention, and the centre's depth in the next camera.
    fn motion(&self, index: usize, center: DVec2) -> (DVec2, f64) {
        let Some((positions, camera)) = &self.next else { return (DVec2::ZERO, 0.0) };
        let point = camera.camera_from_world.transform_point3(positions[index]);
        if !(point.is_finite() && point.z > NEAR) {
            return (DVec2::ZERO, if point.z.is_finite() { point.z } else { 0.0 });
        }
        ((camera.pixel(point) - center) * self.flow_scale(camera), point.z)
    }

    /// Pixels of the flow's convention per pixel of the next camera's image.
    fn flow_scale(&self, next: &Camera) -> DVec2 {
        let convention = self.options.convention;
        DVec2::new(convention.scale(next.width), convention.scale(next.height))
    }

    /// The splats that reach a pixel with their alphas, front to back, from all in the order of [`Sorting::Global`].
    fn reaching<'a>(&self, splats: &'a [Splat], at: DVec2) -> Vec<(&'a Splat, f64)> {
        let alpha = |splat: &Splat| unclamped_alpha(splat, at - splat.center).min(ALPHA_MAX);
        let with_alpha = splats.iter().map(|splat| (splat, alpha(splat)));
        let mut reaching: Vec<_> = with_alpha.filter(|(_, alpha)| *alpha >= ALPHA_MIN).collect();
        match self.options.sorting {
            Sorting::Global => {}
            // A stable sort, by `f32` as for the centres. What is not a number is last.
            Sorting::PerPixel => reaching.sort_by(|(a, _), (b, _)| {
                let depth = |splat: &Splat| (splat.peak.depth(&self.camera, at) as f32).min(f32::MAX);
                depth(a).total_cmp(&depth(b))
            }),
        }
        reaching
    }

    /// Calls `blend` with each splat blended at a pixel, front to back, its alpha, and the transmittance before it. Returns the
    /// final transmittance.
    fn for_each_blended<'a>(
        &self,
        splats: &'a [Splat],
        at: DVec2,
        mut blend: impl FnMut(&'a Splat, f64, f64),
    ) -> f64 {
        let mut transmittance = 1.0;
        for (splat, alpha) in self.reaching(splats, at) {
            let remaining = transmittance * (1.0 - alpha);
            if remaining < TRANSMITTANCE_MIN {
                break;
            }
            blend(splat, alpha, transmittance);
            transmittance = remaining;
        }
        transmittance
    }

    fn blend(&self, splats: &[Splat], at: DVec2) -> Pixel {
        let mut pixel = Pixel::default();
        let transmittance = self.for_each_blended(splats, at, |splat, alpha, transmittance| {
            let weight = transmittance * alpha;
            for channel in 0..3 {
                pixel.color[channel] += weight * splat.color[channel];
            }
            pixel.depth += weight * splat.depth;
            pixel.flow[0] += weight * splat.displacement.x;
            pixel.flow[1] += weight * splat.displacement.y;
            pixel.depth_next += weight * splat.depth_next;
            pixel.blended += 1;
        });
        pixel.alpha = 1.0 - transmittance;
        for (color, behind) in pixel.color.iter_mut().zip(self.options.background) {
            *color += transmittance * f64::from(behind);
        }
        if pixel.blended > 0 {
            pixel.depth /= pixel.alpha;
            pixel.depth_next /= pixel.alpha;
        }
        pixel
    }
}

/// Opacity times the Gaussian at the offset `d` from its centre, before clamping.
fn unclamped_alpha(splat: &Splat, d: DVec2) -> f64 {
    let [xx, xy, yy] = splat.conic;
    let power = -0.5 * (xx * d.x * d.x + yy * d.y * d.y) - xy * d.x * d.y;
    splat.opacity * libm::exp(power.min(0.0))
}

/// World from the axes of a Gaussian, each as long as its standard deviation: `R S`.
fn world_from_axes(rotation: DQuat, scale: DVec3) -> DMat3 {
    DMat3::from_quat(rotation.normalize()) * DMat3::from_diagonal(scale)
}

/// The linear map from the axes of a Gaussian at `point` (in camera coordinates) to the image: the Jacobian of the projection
/// times camera from axes.
fn projection(camera: &Camera, point: DVec3, world_from_axes: DMat3) -> Projection {
    let margin_x = 0.3 * camera.width as f64 / (2.0 * camera.fx);
    let margin_y = 0.3 * camera.height as f64 / (2.0 * camera.fy);
    let left = (-0.5 - camera.cx) / camera.fx - margin_x;
    let right = (camera.width as f64 - 0.5 - camera.cx) / camera.fx + margin_x;
    let top = (-0.5 - camera.cy) / camera.fy - margin_y;
    let bottom = (camera.height as f64 - 0.5 - camera.cy) / camera.fy + margin_y;
    let direction = point.truncate() / point.z;
    let clamped = direction.clamp(DVec2::new(left, top), DVec2::new(right, bottom));
    let jacobian_rows = [
        DVec3::new(camera.fx, 0.0, -camera.fx * clamped.x) / point.z,
        DVec3::new(0.0, camera.fy, -camera.fy * clamped.y) / point.z,
    ];
    let camera_from_axes = DMat3::from_mat4(camera.camera_from_world) * world_from_axes;
    let rows = jacobian_rows.map(|row| camera_from_axes.transpose() * row);
    Projection { direction, clamped, jacobian_rows, camera_from_axes, rows }
}

/// See [`projection`].
struct Projection {
    /// `x / z` and `y / z` of the point.
    direction: DVec2,
    /// The direction at which the Jacobian is taken.
    clamped: DVec2,
    jacobian_rows: [DVec3; 2],
    camera_from_axes: DMat3,
    /// Image from axes.
    rows: [DVec3; 2],
}

/// EWA projection: xx, xy and yy of `J R Sigma R^T J^T`, plus the low-pass filter.
fn covariance(Projection { rows, .. }: &Projection) -> [f64; 3] {
    [rows[0].dot(rows[0]) + LOW_PASS, rows[0].dot(rows[1]), rows[1].dot(rows[1]) + LOW_PASS]
}

/// The square root of the ratio of the covariance's determinants without and with the low-pass filter.
fn compensation(Projection { rows, .. }: &Projection) -> f64 {
    // The determinant of A A^T is the sum of the squared minors of A.
    let sharp = rows[0].cross(rows[1]).length_squared();
    let trace = rows[0].length_squared() + rows[1].length_squared();
    (sharp / (sharp + LOW_PASS * trace + LOW_PASS * LOW_PASS)).sqrt()
}

fn inverse([xx, xy, yy]: [f64; 3]) -> [f64; 3] {
    let determinant = xx * yy - xy * xy;
    [yy / determinant, -xy / determinant, xx / determinant]
}
