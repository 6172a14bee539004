//! Projecting Gaussians on a device: [`crate::projection`], one thread per Gaussian, in `f64` where the device has it.

use cubecl::client::Client;
use cubecl::prelude::*;

use super::buffer::Buffer;
use crate::projection::{Motion, View};
use crate::reference::LOW_PASS;
use crate::{Camera, Gaussians, NEAR, Next, Options};

/// Numbers per splat: the rounded centre (2), what is left of it (2), factor (3), binary logarithm of the opacity, colour (3), depth,
/// displacement (2), depth in the next camera, and one that is not used.
pub(super) const SPLAT: usize = 16;
/// The part that is blended.
pub(super) const FEATURES: usize = 8;
/// The depth bits of a splat that is not drawn: after all others.
pub(super) const HIDDEN: u32 = u32::MAX;

/// One entry per Gaussian.
pub(super) struct Projected {
    pub splats: Buffer<f32>,
    /// Bits of the depth, which sort like the depths, or [`HIDDEN`].
    pub depth_bits: Buffer<u32>,
    /// Two for each: rows and columns of tiles that it can touch, the first in the lower half and one past the last in the upper.
    pub boxes: Buffer<u32>,
    /// 1 if it is drawn without a displacement despite a next frame.
    pub without_displacement: Buffer<u32>,
}

/// Projects every Gaussian; there must be one.
pub(super) fn project(
    client: &Client,
    in_f64: bool,
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
    options: &Options,
) -> Projected {
    let count = gaussians.len();
    let numbers = cameras(camera, next, options);
    let projected = Projected {
        splats: Buffer::empty(client, count * SPLAT),
        depth_bits: Buffer::empty(client, count),
        boxes: Buffer::empty(client, count * 2),
        without_displacement: Buffer::empty(client, count),
    };
    let (launch, cameras) = if in_f64 {
        (
            project_kernel::launch::<f64> as fn(&_, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _),
            Buffer::<f64>::of(client, &numbers).arg(),
        )
    } else {
        let numbers = numbers.map(|number| number as f32);
        (
            project_kernel::launch::<f32> as fn(&_, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _, _),
            Buffer::<f32>::of(client, &numbers).arg(),
        )
    };
    let dim = CubeDim::new(client, count);
    let next_positions = next.map_or(&[][..], |next| &next.gaussians.positions[..]);
    launch(
        client,
        cubecl::calculate_cube_count_elemwise(client, count, dim),
        dim,
        Buffer::<f32>::of(client, &gaussians.positions).arg(),
        Buffer::<f32>::of(client, &gaussians.scales).arg(),
        Buffer::<f32>::of(client, &gaussians.rotations).arg(),
        Buffer::<f32>::of(client, &gaussians.opacities).arg(),
        Buffer::<f32>::of(client, &gaussians.sh).arg(),
        Buffer::<f32>::of(client, next_positions).arg(),
        cameras,
        projected.splats.arg(),
        projected.depth_bits.arg(),
        projected.boxes.arg(),
        projected.without_displacement.arg(),
        gaussians.sh_degree,
        gaussians.antialiased,
        next.is_some(),
    );
    projected
}

const CAMERAS: usize = 44;

/// What the kernel needs of the cameras: [`read_pose`] of the first at 0 and of the next at 16, the first's position at 32, bounds of
/// the Jacobian's direction at 35 (x), 37 (y), the image's size at 39, the scale of the flow at 41, and [`LOW_PASS`] at 43.
fn cameras(camera: &Camera, next: Option<Next<'_>>, options: &Options) -> [f64; CAMERAS] {
    let view = View::new(camera, false);
    let motion = Motion::new(next.map_or(camera, |next| next.camera), options.convention);
    let mut numbers = [0.0; CAMERAS];
    for (camera, numbers) in [camera, &motion.camera].into_iter().zip(numbers.chunks_exact_mut(16)) {
        let columns = camera.camera_from_world.to_cols_array_2d();
        for row in 0..3 {
            for column in 0..4 {
                numbers[4 * row + column] = columns[column][row];
            }
        }
        numbers[12..16].copy_from_slice(&[camera.fx, camera.fy, camera.cx, camera.cy]);
    }
    numbers[32..35].copy_from_slice(&view.position.to_array());
    numbers[35..37].copy_from_slice(&[view.clamp_min.x, view.clamp_max.x]);
    numbers[37..39].copy_from_slice(&[view.clamp_min.y, view.clamp_max.y]);
    numbers[39..41].copy_from_slice(&[camera.width as f64, camera.height as f64]);
    numbers[41..43].copy_from_slice(&motion.scale.to_array());
    numbers[43] = LOW_PASS;
    numbers
}

#[derive(CubeType)]
struct Point<F: Float> {
    x: F,
    y: F,
    z: F,
}

/// A position in the coordinates of a camera whose matrix (3x4, by rows) starts at `matrix`.
#[cube]
fn transform<F: Float>(cameras: &[F], matrix: usize, positions: &[f32], index: usize) -> Point<F> {
    let x = F::cast_from(positions[3 * index]);
    let y = F::cast_from(positions[3 * index + 1]);
    let z = F::cast_from(positions[3 * index + 2]);
    Point::<F> {
        x: cameras[matrix] * x + cameras[matrix + 1] * y + cameras[matrix + 2] * z + cameras[matrix + 3],
        y: cameras[matrix + 4] * x + cameras[matrix + 5] * y + cameras[matrix + 6] * z + cameras[matrix + 7],
        z: cameras[matrix + 8] * x
            + cameras[matrix + 9] * y
            + cameras[matrix + 10] * z
            + cameras[matrix + 11],
    }
}

/// By the bits: arithmetic on numbers that are not finite need not follow IEEE 754 on a device.
#[cube]
fn finite(value: f32) -> bool {
    (value.to_bits() & 0x7F80_0000u32) != 0x7F80_0000u32
}

/// Whether `count` numbers from `first` on are finite.
#[cube]
fn all_finite(values: &[f32], first: usize, count: usize) -> bool {
    let mut all = true;
    for i in 0..count {
        all = all && finite(values[first + i]);
    }
    all
}

/// Whether it remains finite as `f32`.
#[cube]
fn moderate<F: Float>(value: F) -> bool {
    value > F::new(-3.4e38) && value < F::new(3.4e38)
}

#[cube]
fn moderate_point<F: Float>(point: &Point<F>) -> bool {
    moderate::<F>(point.x) && moderate::<F>(point.y) && moderate::<F>(point.z)
}

/// First tile and one past the last of `center - extent ..= center + extent`, packed; 0 if there is none.
#[cube]
fn tiles<F: Float>(center: F, extent: F, size: F) -> u32 {
    let first = (center - extent).ceil().max(F::new(0.0));
    let last = (center + extent).floor().min(size - F::new(1.0));
    let mut packed = 0u32;
    if first <= last {
        packed = (u32::cast_from(first) / 16u32) | ((u32::cast_from(last) / 16u32 + 1u32) << 16u32);
    }
    packed
}

#[cube(launch)]
fn project_kernel<F: Float>(
    positions: &[f32],
    scales: &[f32],
    rotations: &[f32],
    opacities: &[f32],
    sh: &[f32],
    next_positions: &[f32],
    cameras: &[F],
    splats: &mut [f32],
    depth_bits: &mut [u32],
    boxes: &mut [u32],
    without_displacement: &mut [u32],
    #[comptime] sh_degree: usize,
    #[comptime] antialiased: bool,
    #[comptime] motion: bool,
) {
    let index = ABSOLUTE_POS;
    if index >= depth_bits.len() {
        terminate!();
    }
    depth_bits[index] = HIDDEN;
    boxes[2 * index] = 0u32;
    boxes[2 * index + 1] = 0u32;
    without_displacement[index] = 0u32;

    let coefficients = comptime!(3 * (sh_degree + 1) * (sh_degree + 1));
    let valid = all_finite(positions, 3 * index, 3)
        && all_finite(scales, 3 * index, 3)
        && all_finite(rotations, 4 * index, 4)
        && all_finite(opacities, index, 1)
        && all_finite(sh, coefficients * index, coefficients);
    if !valid {
        terminate!();
    }
    let point = transform::<F>(cameras, 0, positions, index);
    if !(point.z > F::new(comptime!(NEAR as f32)) && moderate_point::<F>(&point)) {
        terminate!();
    }

    // The rotation matrix of the normalized quaternion, then the axes in the camera's coordinates.
    let mut qx = F::cast_from(rotations[4 * index]);
    let mut qy = F::cast_from(rotations[4 * index + 1]);
    let mut qz = F::cast_from(rotations[4 * index + 2]);
    let mut qw = F::cast_from(rotations[4 * index + 3]);
    let length = (qx * qx + qy * qy + qz * qz + qw * qw).sqrt();
    if length <= F::new(0.0) {
        terminate!();
    }
    qx /= length;
    qy /= length;
    qz /= length;
    qw /= length;
    let one = F::new(1.0);
    let two = F::new(2.0);
    let (r00, r01, r02) =
        (one - two * (qy * qy + qz * qz), two * (qx * qy - qw * qz), two * (qx * qz + qw * qy));
    let (r10, r11, r12) =
        (two * (qx * qy + qw * qz), one - two * (qx * qx + qz * qz), two * (qy * qz - qw * qx));
    let (r20, r21, r22) =
        (two * (qx * qz - qw * qy), two * (qy * qz + qw * qx), one - two * (qx * qx + qy * qy));
    let (fx, fy, cx, cy) = (cameras[12], cameras[13], cameras[14], cameras[15]);
    let direction_x = (point.x / point.z).max(cameras[35]).min(cameras[36]);
    let direction_y = (point.y / point.z).max(cameras[37]).min(cameras[38]);
    // Rows of the Jacobian times the camera's rotation.
    let scale_x = fx / point.z;
    let scale_y = fy / point.z;
    let hx = (cameras[0] - direction_x * cameras[8]) * scale_x;
    let hy = (cameras[1] - direction_x * cameras[9]) * scale_x;
    let hz = (cameras[2] - direction_x * cameras[10]) * scale_x;
    let vx = (cameras[4] - direction_y * cameras[8]) * scale_y;
    let vy = (cameras[5] - direction_y * cameras[9]) * scale_y;
    let vz = (cameras[6] - direction_y * cameras[10]) * scale_y;
    let s0 = F::cast_from(scales[3 * index]);
    let s1 = F::cast_from(scales[3 * index + 1]);
    let s2 = F::cast_from(scales[3 * index + 2]);
    let (h0, h1, h2) = (
        (hx * r00 + hy * r10 + hz * r20) * s0,
        (hx * r01 + hy * r11 + hz * r21) * s1,
        (hx * r02 + hy * r12 + hz * r22) * s2,
    );
    let (v0, v1, v2) = (
        (vx * r00 + vy * r10 + vz * r20) * s0,
        (vx * r01 + vy * r11 + vz * r21) * s1,
        (vx * r02 + vy * r12 + vz * r22) * s2,
    );
    let low_pass = cameras[43];
    let sharp_xx = h0 * h0 + h1 * h1 + h2 * h2;
    let sharp_yy = v0 * v0 + v1 * v1 + v2 * v2;
    let xy = h0 * v0 + h1 * v1 + h2 * v2;
    let (m0, m1, m2) = (h1 * v2 - h2 * v1, h2 * v0 - h0 * v2, h0 * v1 - h1 * v0);
    let sharp_determinant = m0 * m0 + m1 * m1 + m2 * m2;
    let determinant = sharp_determinant + low_pass * (sharp_xx + sharp_yy) + low_pass * low_pass;
    let xx = sharp_xx + low_pass;
    let yy = sharp_yy + low_pass;

    let mut opacity = opacities[index];
    let smallest = 1.0f32 / 255.0f32;
    let opaque = opacity >= smallest;
    if comptime!(antialiased) {
        opacity *= f32::cast_from((sharp_determinant / determinant).sqrt());
    }
    if !(opaque && opacity >= smallest) {
        terminate!();
    }
    let log2_opacity = opacity.ln() * std::f32::consts::LOG2_E;
    // Twice the natural logarithm of 2, times the difference to the logarithm of 1/255.
    let reach = F::cast_from((1.386_294_4f32 * (log2_opacity + 7.994_353_3f32)).max(0.0f32));
    let center_x = fx * point.x / point.z + cx;
    let center_y = fy * point.y / point.z + cy;
    let enlarged = F::new(1.0001);
    let margin = F::new(0.001);
    let columns = tiles::<F>(center_x, (reach * xx).sqrt() * enlarged + margin, cameras[39]);
    let rows = tiles::<F>(center_y, (reach * yy).sqrt() * enlarged + margin, cameras[40]);
    if columns == 0u32 || rows == 0u32 {
        terminate!();
    }
    let depth = f32::cast_from(point.z);
    depth_bits[index] = depth.to_bits();
    boxes[2 * index] = rows;
    boxes[2 * index + 1] = columns;

    let at = index * SPLAT;
    let rounded_x = (center_x + F::new(0.5)).floor();
    let rounded_y = (center_y + F::new(0.5)).floor();
    splats[at] = f32::cast_from(rounded_x);
    splats[at + 1] = f32::cast_from(rounded_y);
    splats[at + 2] = f32::cast_from(center_x - rounded_x);
    splats[at + 3] = f32::cast_from(center_y - rounded_y);
    // The square root of half the binary logarithm of e.
    let unit = F::new(0.849_321_8);
    splats[at + 4] = f32::cast_from(unit * (yy / determinant).sqrt());
    splats[at + 5] = f32::cast_from(unit * (F::new(0.0) - xy) / (yy * determinant).sqrt());
    splats[at + 6] = f32::cast_from(unit / yy.sqrt());
    splats[at + 7] = log2_opacity;

    let mut basis = Array::<f32>::new(comptime!(coefficients / 3));
    basis[0] = 0.282_094_79f32;
    if comptime!(sh_degree >= 1) {
        let dx = F::cast_from(positions[3 * index]) - cameras[32];
        let dy = F::cast_from(positions[3 * index + 1]) - cameras[33];
        let dz = F::cast_from(positions[3 * index + 2]) - cameras[34];
        let distance = (dx * dx + dy * dy + dz * dz).sqrt();
        let x = f32::cast_from(dx / distance);
        let y = f32::cast_from(dy / distance);
        let z = f32::cast_from(dz / distance);
        harmonics(&mut basis, x, y, z, sh_degree);
    }
    for channel in 0..3usize {
        let mut color = 0.5f32;
        for i in 0..comptime!(coefficients / 3) {
            color += basis[i] * sh[coefficients * index + 3 * i + channel];
        }
        splats[at + FEATURES + channel] = color.max(0.0f32);
    }
    splats[at + 11] = depth;
    splats[at + 12] = 0.0f32;
    splats[at + 13] = 0.0f32;
    splats[at + 14] = 0.0f32;
    splats[at + 15] = 0.0f32;
    if comptime!(motion) {
        let mut moved = false;
        if all_finite(next_positions, 3 * index, 3) {
            let next = transform::<F>(cameras, 16, next_positions, index);
            if moderate::<F>(next.z) {
                splats[at + 14] = f32::cast_from(next.z);
            }
            if next.z > F::new(comptime!(NEAR as f32)) && moderate_point::<F>(&next) {
                let u = (cameras[28] * next.x / next.z + cameras[30] - center_x) * cameras[41];
                let v = (cameras[29] * next.y / next.z + cameras[31] - center_y) * cameras[42];
                if moderate::<F>(u) && moderate::<F>(v) {
                    splats[at + 12] = f32::cast_from(u);
                    splats[at + 13] = f32::cast_from(v);
                    moved = true;
                }
            }
        }
        if !moved {
            without_displacement[index] = 1u32;
        }
    }
}

/// The basis functions of [`crate::sh`] after the first.
#[cube]
fn harmonics(basis: &mut Array<f32>, x: f32, y: f32, z: f32, #[comptime] degree: usize) {
    basis[1] = -0.488_602_5f32 * y;
    basis[2] = 0.488_602_5f32 * z;
    basis[3] = -0.488_602_5f32 * x;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if comptime!(degree >= 2) {
        basis[4] = 1.092_548_4f32 * x * y;
        basis[5] = -1.092_548_4f32 * y * z;
        basis[6] = 0.315_391_57f32 * (2.0f32 * zz - xx - yy);
        basis[7] = -1.092_548_4f32 * x * z;
        basis[8] = 0.546_274_2f32 * (xx - yy);
    }
    if comptime!(degree >= 3) {
        basis[9] = -0.590_043_6f32 * y * (3.0f32 * xx - yy);
        basis[10] = 2.890_611_4f32 * x * y * z;
        basis[11] = -0.457_045_8f32 * y * (4.0f32 * zz - xx - yy);
        basis[12] = 0.373_176_33f32 * z * (2.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy);
        basis[13] = -0.457_045_8f32 * x * (4.0f32 * zz - xx - yy);
        basis[14] = 1.445_305_7f32 * z * (xx - yy);
        basis[15] = -0.590_043_6f32 * x * (xx - 3.0f32 * yy);
    }
}
