//! Projecting Gaussians to splats: ellipses on the image plane with the features to blend.

use glam::{DMat3, DMat4, DVec2, DVec3, Vec3};
use rayon::prelude::*;

use crate::reference::{ALPHA_MIN, LOW_PASS};
use crate::{Camera, Gaussians, NEAR, Next, Options, PixelConvention, sh};

/// `log2(1/255)`.
pub(crate) const LOG2_ALPHA_MIN: f32 = -7.994_353_3;

/// Sides of a tile in pixels.
pub(crate) const TILE: usize = 16;

/// A Gaussian on the image plane, the size of a cache line.
///
/// With `d` the offset from the centre, its alpha there is `2^(log2_opacity - e1^2 - e2^2)`, where
/// `e1 = xx * d.x + xy * d.y` and `e2 = yy * d.y`. This triangular factor of the inverse covariance keeps its precision
/// for needles, where the sum of the conic's three terms would cancel, and is never negative.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C, align(64))]
pub(crate) struct Splat {
    /// In pixels. `f64`, since a pixel coordinate in `f32` has an error of up to 1e-4 px.
    pub center: [f64; 2],
    /// `xx`, `xy`, `yy` in 1/px.
    pub factor: [f32; 3],
    pub log2_opacity: f32,
    /// Red, green, blue, depth, displacement u and v, depth in the next camera.
    pub features: [f32; 7],
}

/// The depth and tiles of a splat.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Placement {
    /// Bits of the depth as `f32`, which sort like the depths.
    pub depth_bits: u32,
    /// Rows of tiles that it can touch: first, and one past the last. Empty if it is not drawn.
    pub rows: [u16; 2],
    /// Columns of tiles, likewise.
    pub columns: [u16; 2],
}

impl Placement {
    const HIDDEN: Self = Self { depth_bits: 0, rows: [0; 2], columns: [0; 2] };

    pub(crate) fn is_hidden(self) -> bool {
        self == Self::HIDDEN
    }
}

/// Projects every Gaussian, in parallel. `splats` and `placements` get one entry per Gaussian; that of a hidden splat is
/// unspecified. Returns the number of drawn splats without a displacement despite a next frame.
pub(crate) fn project(
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
    options: &Options,
    splats: &mut Vec<Splat>,
    placements: &mut Vec<Placement>,
) -> usize {
    const CHUNK: usize = 2048;
    splats.resize(gaussians.len(), Splat::default());
    placements.resize(gaussians.len(), Placement::HIDDEN);
    let view = View::new(camera, gaussians.antialiased);
    let motion = next.map(|next| (next.gaussians, Motion::new(next.camera, options.convention)));
    splats
        .par_chunks_mut(CHUNK)
        .zip(placements.par_chunks_mut(CHUNK))
        .enumerate()
        .map(|(chunk, (splats, placements))| {
            let mut without_displacement = 0;
            for (i, (splat, placement)) in splats.iter_mut().zip(placements).enumerate() {
                let index = chunk * CHUNK + i;
                *placement = view.project(gaussians, index, splat).unwrap_or(Placement::HIDDEN);
                if placement.is_hidden() {
                    continue;
                }
                if let Some((gaussians, motion)) = &motion
                    && !motion.apply(gaussians.positions[index], splat)
                {
                    without_displacement += 1;
                }
            }
            without_displacement
        })
        .sum()
}

/// A camera with derived values.
pub(crate) struct View {
    pub camera: Camera,
    /// Camera from world.
    pub rotation: DMat3,
    /// Of the camera, in the world.
    pub position: DVec3,
    /// Bounds of the direction at which the Jacobian is taken; see the notes in [`crate::reference`].
    pub clamp_min: DVec2,
    pub clamp_max: DVec2,
    /// See [`Gaussians::antialiased`].
    pub antialiased: bool,
}

impl View {
    pub(crate) fn new(camera: &Camera, antialiased: bool) -> Self {
        let size = DVec2::new(camera.width as f64, camera.height as f64);
        let focal = DVec2::new(camera.fx, camera.fy);
        let principal = DVec2::new(camera.cx, camera.cy);
        let margin = 0.15 * size / focal;
        Self {
            camera: *camera,
            rotation: DMat3::from_mat4(camera.camera_from_world),
            position: camera.position(),
            clamp_min: (DVec2::splat(-0.5) - principal) / focal - margin,
            clamp_max: (size - 0.5 - principal) / focal + margin,
            antialiased,
        }
    }

    /// Fills `splat` except for the motion, and returns its placement; `None` if it is not drawn.
    fn project(&self, gaussians: &Gaussians, index: usize, splat: &mut Splat) -> Option<Placement> {
        let position = gaussians.positions[index].as_dvec3();
        let point = self.camera.camera_from_world.transform_point3(position);
        let opacity = f64::from(gaussians.opacities[index]);
        let sh = &gaussians.sh[index * gaussians.sh_len()..][..gaussians.sh_len()];
        // Written such that NaN is hidden too.
        let drawn = point.z > NEAR && opacity >= ALPHA_MIN;
        let finite = point.is_finite() && (point.z as f32).is_finite() && opacity.is_finite();
        if !(drawn && finite && sh.as_flattened().iter().all(|c| c.is_finite())) {
            return None;
        }
        let ellipse = self.ellipse(gaussians, index, point)?;
        let opacity = if self.antialiased { opacity * ellipse.compensation() } else { opacity };
        let drawn = opacity >= ALPHA_MIN;
        if !drawn {
            return None;
        }
        let center = self.camera.pixel(point);
        let log2_opacity = libm::log2(opacity);
        let extent = ellipse.extent(log2_opacity);
        let columns = tiles(center.x, extent.x, self.camera.width)?;
        let rows = tiles(center.y, extent.y, self.camera.height)?;

        let color = sh::color(gaussians.sh_degree, sh, position - self.position);
        let [r, g, b] = color.map(|channel| channel as f32);
        let depth = point.z as f32;
        *splat = Splat {
            center: center.to_array(),
            factor: ellipse.factor(),
            log2_opacity: log2_opacity as f32,
            features: [r, g, b, depth, 0.0, 0.0, 0.0],
        };
        Some(Placement { depth_bits: depth.to_bits(), rows, columns })
    }

    /// The direction at which the Jacobian is taken, for a point in this one.
    pub(crate) fn clamped(&self, direction: DVec2) -> DVec2 {
        direction.clamp(self.clamp_min, self.clamp_max)
    }

    /// EWA projection of the covariance at `point`, low-pass filter included; `None` for invalid parameters.
    fn ellipse(&self, gaussians: &Gaussians, index: usize, point: DVec3) -> Option<Ellipse> {
        let scale = gaussians.scales[index].as_dvec3();
        let rotation = gaussians.rotations[index].as_dquat();
        let length = rotation.length();
        if !(scale.is_finite() && length.is_finite() && length > 0.0) {
            return None;
        }
        let axes = self.rotation * DMat3::from_quat(rotation / length);
        let direction = self.clamped(point.truncate() / point.z);
        let (x, y, z) = (axes.row(0), axes.row(1), axes.row(2));
        let horizontal = (x - direction.x * z) * scale * (self.camera.fx / point.z);
        let vertical = (y - direction.y * z) * scale * (self.camera.fy / point.z);
        let xx = horizontal.length_squared();
        let yy = vertical.length_squared();
        // The determinant of A A^T is the sum of the squared minors of A: no cancellation for needles.
        let sharp_determinant = horizontal.cross(vertical).length_squared();
        let determinant = sharp_determinant + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
        Some(Ellipse {
            xx: xx + LOW_PASS,
            xy: horizontal.dot(vertical),
            yy: yy + LOW_PASS,
            determinant,
            sharp_determinant,
        })
    }
}

/// Tiles, first and one past the last, of the pixels `center - extent ..= center + extent` of an image side of `size` pixels;
/// `None` without such pixels.
fn tiles(center: f64, extent: f64, size: usize) -> Option<[u16; 2]> {
    let first = (center - extent).ceil().max(0.0);
    let last = (center + extent).floor().min(size as f64 - 1.0);
    (first <= last).then(|| [(first as usize / TILE) as u16, (last as usize / TILE) as u16 + 1])
}

/// A projected covariance in px^2.
struct Ellipse {
    xx: f64,
    xy: f64,
    yy: f64,
    determinant: f64,
    /// The determinant without the low-pass filter, px^4.
    sharp_determinant: f64,
}

impl Ellipse {
    /// The factor by which the low-pass filter reduces the opacity; see [`Gaussians::antialiased`].
    fn compensation(&self) -> f64 {
        (self.sharp_determinant / self.determinant).sqrt()
    }

    /// Half sides in pixels of the box around the pixels whose alpha is at least 1/255.
    fn extent(&self, log2_opacity: f64) -> DVec2 {
        // Alpha reaches 1/255 where the squared Mahalanobis distance is at most this.
        let reach = 2.0 * std::f64::consts::LN_2 * (log2_opacity - f64::from(LOG2_ALPHA_MIN)).max(0.0);
        // Slightly enlarged, so that no rounding in the f32 blending can reach a pixel outside.
        DVec2::new((reach * self.xx).sqrt(), (reach * self.yy).sqrt()) * 1.0001 + 0.001
    }

    /// [`Splat::factor`]: the inverse covariance is `2 ln 2` times the factor's transpose times the factor.
    fn factor(&self) -> [f32; 3] {
        let unit = (0.5 * std::f64::consts::LOG2_E).sqrt();
        let xx = (self.yy / self.determinant).sqrt();
        let xy = -self.xy / (self.yy * self.determinant).sqrt();
        let yy = 1.0 / self.yy.sqrt();
        [xx, xy, yy].map(|entry| (unit * entry) as f32)
    }
}

/// The target camera of the flow.
pub(crate) struct Motion {
    pub camera: Camera,
    pub camera_from_world: DMat4,
    /// Pixels of the flow's convention per pixel of the image.
    pub scale: DVec2,
}

impl Motion {
    pub(crate) fn new(camera: &Camera, convention: PixelConvention) -> Self {
        Self {
            camera: *camera,
            camera_from_world: camera.camera_from_world,
            scale: DVec2::new(convention.scale(camera.width), convention.scale(camera.height)),
        }
    }

    /// Fills the splat's displacement and next depth; `false` when it has no displacement.
    fn apply(&self, position: Vec3, splat: &mut Splat) -> bool {
        let point = self.camera_from_world.transform_point3(position.as_dvec3());
        let depth = point.z as f32;
        splat.features[6] = if depth.is_finite() { depth } else { 0.0 };
        let displacement = self.displacement(point, splat);
        if let Some(displacement) = displacement {
            splat.features[4..6].copy_from_slice(&displacement);
        }
        displacement.is_some()
    }

    /// Displacement of the splat whose centre moves to `point`, in coordinates of the next camera.
    pub(crate) fn displacement(&self, point: DVec3, splat: &Splat) -> Option<[f32; 2]> {
        if !(point.is_finite() && point.z > NEAR) {
            return None;
        }
        let displacement = (self.camera.pixel(point) - DVec2::from_array(splat.center)) * self.scale;
        let [u, v] = [displacement.x as f32, displacement.y as f32];
        (u.is_finite() && v.is_finite()).then_some([u, v])
    }
}
