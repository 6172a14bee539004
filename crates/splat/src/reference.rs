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

use glam::{DMat3, DVec2, DVec3};

use crate::{Camera, Gaussians, NEAR, Next, Options, RasterizeError, sh};

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

/// A Gaussian on the image plane.
struct Splat {
    center: DVec2,
    /// Inverse of the projected covariance: xx, xy, yy.
    conic: [f64; 3],
    opacity: f64,
    color: [f64; 3],
    depth: f64,
    displacement: DVec2,
    depth_next: f64,
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
    crate::rasterizer::validate(gaussians, camera, next)?;
    let mut splats: Vec<Splat> =
        (0..gaussians.len()).filter_map(|i| project(gaussians, i, camera, next, options)).collect();
    splats.sort_by(|a, b| (a.depth as f32).total_cmp(&(b.depth as f32))); // stable: equal depths keep their order
    let mut pixels = Vec::with_capacity(camera.width * camera.height);
    for y in 0..camera.height {
        for x in 0..camera.width {
            pixels.push(blend(&splats, DVec2::new(x as f64, y as f64), options.background));
        }
    }
    Ok(pixels)
}

fn blend(splats: &[Splat], at: DVec2, background: [f32; 3]) -> Pixel {
    let mut pixel = Pixel::default();
    let mut transmittance = 1.0;
    for splat in splats {
        let d = at - splat.center;
        let [xx, xy, yy] = splat.conic;
        let power = -0.5 * (xx * d.x * d.x + yy * d.y * d.y) - xy * d.x * d.y;
        let alpha = (splat.opacity * libm::exp(power.min(0.0))).min(ALPHA_MAX);
        if alpha < ALPHA_MIN {
            continue;
        }
        let remaining = transmittance * (1.0 - alpha);
        if remaining < TRANSMITTANCE_MIN {
            break;
        }
        let weight = transmittance * alpha;
        for channel in 0..3 {
            pixel.color[channel] += weight * splat.color[channel];
        }
        pixel.depth += weight * splat.depth;
        pixel.flow[0] += weight * splat.displacement.x;
        pixel.flow[1] += weight * splat.displacement.y;
        pixel.depth_next += weight * splat.depth_next;
        pixel.blended += 1;
        transmittance = remaining;
    }
    pixel.alpha = 1.0 - transmittance;
    for (color, behind) in pixel.color.iter_mut().zip(background) {
        *color += transmittance * f64::from(behind);
    }
    if pixel.blended > 0 {
        pixel.depth /= pixel.alpha;
        pixel.depth_next /= pixel.alpha;
    }
    pixel
}

fn project(
    gaussians: &Gaussians,
    index: usize,
    camera: &Camera,
    next: Option<Next<'_>>,
    options: &Options,
) -> Option<Splat> {
    let position = gaussians.positions[index].as_dvec3();
    let scale = gaussians.scales[index].as_dvec3();
    let rotation = gaussians.rotations[index].as_dquat();
    let opacity = f64::from(gaussians.opacities[index]);
    let sh = &gaussians.sh[index * gaussians.sh_len()..][..gaussians.sh_len()];
    let finite = position.is_finite()
        && scale.is_finite()
        && rotation.is_finite()
        && opacity.is_finite()
        && sh.as_flattened().iter().all(|c| c.is_finite());
    let point = camera.camera_from_world.transform_point3(position);
    if !finite || rotation.length() == 0.0 || opacity < ALPHA_MIN || point.z <= NEAR {
        return None;
    }
    let world_from_axes = DMat3::from_quat(rotation.normalize()) * DMat3::from_diagonal(scale);
    let covariance = projected_covariance(camera, point, world_from_axes);
    let center = camera.pixel(point);
    let (displacement, depth_next) = motion(index, center, next, options);
    Some(Splat {
        center,
        conic: inverse(covariance),
        opacity,
        color: sh::color(gaussians.sh_degree, sh, position - camera.position()),
        depth: point.z,
        displacement,
        depth_next,
    })
}

/// EWA projection: xx, xy and yy of `J R Sigma R^T J^T`, J the Jacobian of the projection at `point`, plus the
/// low-pass filter.
fn projected_covariance(camera: &Camera, point: DVec3, world_from_axes: DMat3) -> [f64; 3] {
    let margin_x = 0.3 * camera.width as f64 / (2.0 * camera.fx);
    let margin_y = 0.3 * camera.height as f64 / (2.0 * camera.fy);
    let left = (-0.5 - camera.cx) / camera.fx - margin_x;
    let right = (camera.width as f64 - 0.5 - camera.cx) / camera.fx + margin_x;
    let top = (-0.5 - camera.cy) / camera.fy - margin_y;
    let bottom = (camera.height as f64 - 0.5 - camera.cy) / camera.fy + margin_y;
    let x = (point.x / point.z).clamp(left, right);
    let y = (point.y / point.z).clamp(top, bottom);
    let jacobian_rows = [
        DVec3::new(camera.fx, 0.0, -camera.fx * x) / point.z,
        DVec3::new(0.0, camera.fy, -camera.fy * y) / point.z,
    ];
    let camera_from_axes = DMat3::from_mat4(camera.camera_from_world) * world_from_axes;
    let rows = jacobian_rows.map(|row| camera_from_axes.transpose() * row);
    [rows[0].dot(rows[0]) + LOW_PASS, rows[0].dot(rows[1]), rows[1].dot(rows[1]) + LOW_PASS]
}

fn inverse([xx, xy, yy]: [f64; 3]) -> [f64; 3] {
    let determinant = xx * yy - xy * xy;
    [yy / determinant, -xy / determinant, xx / determinant]
}

/// Displacement of the projected centre in pixels of the convention, and the centre's depth in the next camera.
fn motion(index: usize, center: DVec2, next: Option<Next<'_>>, options: &Options) -> (DVec2, f64) {
    let Some(next) = next else { return (DVec2::ZERO, 0.0) };
    let point = next.camera.camera_from_world.transform_point3(next.gaussians.positions[index].as_dvec3());
    if !(point.is_finite() && point.z > NEAR) {
        return (DVec2::ZERO, if point.z.is_finite() { point.z } else { 0.0 });
    }
    let scale =
        DVec2::new(options.convention.scale(next.camera.width), options.convention.scale(next.camera.height));
    ((next.camera.pixel(point) - center) * scale, point.z)
}
