//! Projecting Gaussians to splats: ellipses on the image plane with the features to blend.

use std::ops::Range;

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3, Quat, Vec3};
use rayon::prelude::*;
use srflow_simd::{Isa, Simd, dispatch};

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
    isa: Isa,
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
            project_chunk(isa, &view, gaussians, motion.as_ref(), chunk * CHUNK, splats, placements)
        })
        .sum()
}

dispatch! {
    /// [`project`] for the Gaussians from number `start` on.
    fn project_chunk = project_blocks(
        view: &View,
        gaussians: &Gaussians,
        motion: Option<&(&Gaussians, Motion)>,
        start: usize,
        splats: &mut [Splat],
        placements: &mut [Placement],
    ) -> usize
}

#[inline(always)]
fn project_blocks<S: Simd>(
    _: S,
    view: &View,
    gaussians: &Gaussians,
    motion: Option<&(&Gaussians, Motion)>,
    start: usize,
    splats: &mut [Splat],
    placements: &mut [Placement],
) -> usize {
    let mut block = Block::default();
    let mut without_displacement = 0;
    let chunks = splats.chunks_mut(BLOCK).zip(placements.chunks_mut(BLOCK));
    for (number, (splats, placements)) in chunks.enumerate() {
        let start = start + number * BLOCK;
        block.fill(view, gaussians, start..start + splats.len());
        for (i, (splat, placement)) in splats.iter_mut().zip(placements).enumerate() {
            let index = start + i;
            *placement = view.place(gaussians, index, &block.get(i), splat).unwrap_or(Placement::HIDDEN);
            if placement.is_hidden() {
                continue;
            }
            if let Some((gaussians, motion)) = motion
                && !motion.apply(gaussians.positions[index], splat)
            {
                without_displacement += 1;
            }
        }
    }
    without_displacement
}

/// Gaussians whose shapes are computed together, in vectors.
const BLOCK: usize = 64;

/// One Gaussian on the image plane. The numbers of a Gaussian that is not valid mean nothing.
#[derive(Debug, Clone, Copy)]
struct Shape {
    /// In the camera.
    point: DVec3,
    /// In pixels.
    center: DVec2,
    /// First and last pixel whose alpha can be 1/255, within the image; none if the last is before the first.
    first: DVec2,
    last: DVec2,
    factor: DVec3,
    /// Reduced by the low-pass filter, if [`Gaussians::antialiased`].
    opacity: f64,
    log2_opacity: f64,
    /// Length of its quaternion.
    length: f64,
}

/// Each number of a [`Shape`], for all Gaussians of a block.
struct Block([[f64; BLOCK]; 15]);

impl Default for Block {
    fn default() -> Self {
        Self([[0.0; BLOCK]; 15])
    }
}

impl Block {
    /// Computes the shapes of so many Gaussians, in order.
    #[inline(always)]
    fn fill(&mut self, view: &View, gaussians: &Gaussians, these: Range<usize>) {
        let count = these.len().min(BLOCK);
        // Slices of one length: the loop has no checks, and becomes vector instructions.
        let positions = &gaussians.positions[these.clone()][..count];
        let scales = &gaussians.scales[these.clone()][..count];
        let rotations = &gaussians.rotations[these.clone()][..count];
        let opacities = &gaussians.opacities[these][..count];
        for i in 0..count {
            let Shape { point, center, first, last, factor, opacity, log2_opacity, length } =
                view.shape(positions[i], scales[i], rotations[i], opacities[i]);
            let numbers = [
                point.x,
                point.y,
                point.z,
                center.x,
                center.y,
                first.x,
                first.y,
                last.x,
                last.y,
                factor.x,
                factor.y,
                factor.z,
                opacity,
                log2_opacity,
                length,
            ];
            for (row, number) in self.0.iter_mut().zip(numbers) {
                row[i] = number;
            }
        }
    }

    #[inline(always)]
    fn get(&self, i: usize) -> Shape {
        let pair = |row: usize| DVec2::new(self.0[row][i], self.0[row + 1][i]);
        let triple = |row: usize| pair(row).extend(self.0[row + 2][i]);
        Shape {
            point: triple(0),
            center: pair(3),
            first: pair(5),
            last: pair(7),
            factor: triple(9),
            opacity: self.0[12][i],
            log2_opacity: self.0[13][i],
            length: self.0[14][i],
        }
    }
}

/// The base-2 logarithm of a positive normal number, without branches: `libm::log2`, to the bit.
#[inline(always)]
fn log2(x: f64) -> f64 {
    const INVERSE_LN2: [f64; 2] = [1.442_695_040_721_446_3, 1.675_171_316_488_651_2e-10];
    const POLYNOMIAL: [f64; 7] = [
        6.666_666_666_666_735e-1,
        3.999_999_999_940_942e-1,
        2.857_142_874_366_239e-1,
        2.222_219_843_214_978_4e-1,
        1.818_357_216_161_805e-1,
        1.531_383_769_920_937_3e-1,
        1.479_819_860_511_658_6e-1,
    ];
    /// High half of `sqrt(1/2)`, from which mantissas count.
    const SQRT_HALF: u64 = 0x3fe6_a09e << 32;
    const ONE: u64 = 0x3ff0_0000 << 32;
    const MANTISSA: u64 = 0x000f_ffff_ffff_ffff;
    let bits = x.to_bits().wrapping_add(ONE - SQRT_HALF);
    let exponent = (bits >> 52) as i32 - 0x3ff;
    let f = f64::from_bits((bits & MANTISSA).wrapping_add(SQRT_HALF)) - 1.0;
    let half_square = 0.5 * f * f;
    let s = f / (2.0 + f);
    let z = s * s;
    let w = z * z;
    let [p1, p2, p3, p4, p5, p6, p7] = POLYNOMIAL;
    let rest = z * (p1 + w * (p3 + w * (p5 + w * p7))) + w * (p2 + w * (p4 + w * p6));
    let high = f64::from_bits((f - half_square).to_bits() & !0xffff_ffff);
    let low = f - high - half_square + s * (half_square + rest);
    let [unit_high, unit_low] = INVERSE_LN2;
    let (high, low) = (high * unit_high, (low + high) * unit_low + low * unit_high);
    let whole = f64::from(exponent) + high;
    low + (f64::from(exponent) - whole + high) + whole
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

    /// Without branches and calls, so that loops over it become vector instructions.
    #[inline(always)]
    fn shape(&self, position: Vec3, scale: Vec3, rotation: Quat, opacity: f32) -> Shape {
        let point = self.camera.camera_from_world.transform_point3(position.as_dvec3());
        let rotation = rotation.as_dquat();
        // glam's `length` calls libm; the square root of IEEE 754 has the same bits.
        let length = rotation.length_squared().sqrt();
        let ellipse = self.ellipse(scale.as_dvec3(), rotation / length, point);
        let opacity = f64::from(opacity);
        let opacity = if self.antialiased { opacity * ellipse.compensation() } else { opacity };
        let log2_opacity = log2(opacity);
        let center = self.camera.pixel(point);
        let extent = ellipse.extent(log2_opacity);
        let [first_x, last_x] = pixels(center.x, extent.x, self.camera.width);
        let [first_y, last_y] = pixels(center.y, extent.y, self.camera.height);
        Shape {
            point,
            center,
            first: DVec2::new(first_x, first_y),
            last: DVec2::new(last_x, last_y),
            factor: ellipse.factor(),
            opacity,
            log2_opacity,
            length,
        }
    }

    /// Fills `splat` except for the motion, and returns its placement; `None` if it is not drawn.
    #[inline(always)]
    fn place(
        &self,
        gaussians: &Gaussians,
        index: usize,
        shape: &Shape,
        splat: &mut Splat,
    ) -> Option<Placement> {
        let Shape { point, center, first, last, factor, opacity, log2_opacity, length } = *shape;
        let sh = &gaussians.sh[index * gaussians.sh_len()..][..gaussians.sh_len()];
        // Written such that NaN is hidden too.
        let drawn = point.z > NEAR && opacity >= ALPHA_MIN;
        let finite = point.is_finite() && (point.z as f32).is_finite() && opacity.is_finite();
        let shaped = gaussians.scales[index].is_finite() && length.is_finite() && length > 0.0;
        let seen = first.x <= last.x && first.y <= last.y;
        if !(drawn && finite && shaped && seen && sh.as_flattened().iter().all(|c| c.is_finite())) {
            return None;
        }
        let position = gaussians.positions[index].as_dvec3();
        let color = sh::color(gaussians.sh_degree, sh, position - self.position);
        let [r, g, b] = color.map(|channel| channel as f32);
        let depth = point.z as f32;
        *splat = Splat {
            center: center.to_array(),
            factor: factor.as_vec3().to_array(),
            log2_opacity: log2_opacity as f32,
            features: [r, g, b, depth, 0.0, 0.0, 0.0],
        };
        let tiles =
            |first: f64, last: f64| [(first as usize / TILE) as u16, (last as usize / TILE) as u16 + 1];
        Some(Placement {
            depth_bits: depth.to_bits(),
            rows: tiles(first.y, last.y),
            columns: tiles(first.x, last.x),
        })
    }

    /// The direction at which the Jacobian is taken, for a point in this one.
    #[inline(always)]
    pub(crate) fn clamped(&self, direction: DVec2) -> DVec2 {
        direction.clamp(self.clamp_min, self.clamp_max)
    }

    /// EWA projection of the covariance at `point`, low-pass filter included.
    #[inline(always)]
    fn ellipse(&self, scale: DVec3, rotation: DQuat, point: DVec3) -> Ellipse {
        let axes = self.rotation * DMat3::from_quat(rotation);
        let direction = self.clamped(point.truncate() / point.z);
        let (x, y, z) = (axes.row(0), axes.row(1), axes.row(2));
        let horizontal = (x - direction.x * z) * scale * (self.camera.fx / point.z);
        let vertical = (y - direction.y * z) * scale * (self.camera.fy / point.z);
        let xx = horizontal.length_squared();
        let yy = vertical.length_squared();
        // The determinant of A A^T is the sum of the squared minors of A: no cancellation for needles.
        let sharp_determinant = horizontal.cross(vertical).length_squared();
        let determinant = sharp_determinant + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
        Ellipse {
            xx: xx + LOW_PASS,
            xy: horizontal.dot(vertical),
            yy: yy + LOW_PASS,
            determinant,
            sharp_determinant,
        }
    }
}

/// First and last of the pixels `center - extent ..= center + extent` of an image side of `size` pixels.
#[inline(always)]
fn pixels(center: f64, extent: f64, size: usize) -> [f64; 2] {
    [(center - extent).ceil().max(0.0), (center + extent).floor().min(size as f64 - 1.0)]
}

/// A projected covariance in px^2.
#[derive(Debug, Clone, Copy)]
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
    #[inline(always)]
    fn compensation(&self) -> f64 {
        (self.sharp_determinant / self.determinant).sqrt()
    }

    /// Half sides in pixels of the box around the pixels whose alpha is at least 1/255.
    #[inline(always)]
    fn extent(&self, log2_opacity: f64) -> DVec2 {
        // Alpha reaches 1/255 where the squared Mahalanobis distance is at most this.
        let reach = 2.0 * std::f64::consts::LN_2 * (log2_opacity - f64::from(LOG2_ALPHA_MIN)).max(0.0);
        // Slightly enlarged, so that no rounding in the f32 blending can reach a pixel outside.
        DVec2::new((reach * self.xx).sqrt(), (reach * self.yy).sqrt()) * 1.0001 + 0.001
    }

    /// [`Splat::factor`]: the inverse covariance is `2 ln 2` times the factor's transpose times the factor.
    #[inline(always)]
    fn factor(&self) -> DVec3 {
        let unit = (0.5 * std::f64::consts::LOG2_E).sqrt();
        let xx = (self.yy / self.determinant).sqrt();
        let xy = -self.xy / (self.yy * self.determinant).sqrt();
        let yy = 1.0 / self.yy.sqrt();
        DVec3::new(unit * xx, unit * xy, unit * yy)
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
    #[inline(always)]
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
    #[inline(always)]
    pub(crate) fn displacement(&self, point: DVec3, splat: &Splat) -> Option<[f32; 2]> {
        if !(point.is_finite() && point.z > NEAR) {
            return None;
        }
        let displacement = (self.camera.pixel(point) - DVec2::from_array(splat.center)) * self.scale;
        let [u, v] = [displacement.x as f32, displacement.y as f32];
        (u.is_finite() && v.is_finite()).then_some([u, v])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_core::random::Key;

    #[test]
    fn log2_has_the_bits_of_libm() {
        let mut stream = Key::new(1).stream("log2");
        let random = (0..200_000).map(|_| f64::from(stream.bits()) / f64::from(1_u32 << stream.below(31)));
        let known = [1.0, ALPHA_MIN, 0.99, 0.5, std::f64::consts::FRAC_1_SQRT_2, f64::MIN_POSITIVE, f64::MAX];
        for x in random.filter(|x| *x > 0.0).chain(known) {
            assert_eq!(log2(x).to_bits(), libm::log2(x).to_bits(), "{x}");
        }
    }
}
