use glam::{DMat3, DVec3};

// Factors of the basis functions.
const C1: f64 = 0.488_602_511_902_919_9; // sqrt(3 / pi) / 2
const C2: f64 = 1.092_548_430_592_079_2; // sqrt(15 / pi) / 2
const C20: f64 = 0.315_391_565_252_520_05; // sqrt(5 / pi) / 4
const C33: f64 = 0.590_043_589_926_643_5; // sqrt(35 / (2 pi)) / 4
const C32: f64 = 2.890_611_442_640_554; // sqrt(105 / pi) / 2
const C31: f64 = 0.457_045_799_464_465_8; // sqrt(21 / (2 pi)) / 4
const C30: f64 = 0.373_176_332_590_115_4; // sqrt(7 / pi) / 4

/// The spherical harmonic of degree 0: colour per coefficient, `sqrt(1 / pi) / 2`.
pub const SH_0: f64 = 0.282_094_791_773_878_14;

/// Multiplies the colour of the Gaussian with the coefficients `sh` by `factor`, red, green and blue, about the colour `0.5 - level`: 0.5 scales
/// the colour itself.
pub fn scale_colour(sh: &mut [[f32; 3]], factor: [f32; 3], level: f32) {
    for (number, coefficient) in sh.iter_mut().enumerate() {
        for (value, factor) in coefficient.iter_mut().zip(factor) {
            // The colour is 0.5 and the sum of the terms.
            let constant = if number == 0 { level * (factor - 1.0) / SH_0 as f32 } else { 0.0 };
            *value = *value * factor + constant;
        }
    }
}

/// Coefficients per Gaussian of spherical harmonics of `degree`.
pub(crate) const fn coefficients(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// The real spherical harmonics of degree 0 to 3 at the unit vector `direction`, in the order and with the signs of
/// the 3DGS reference (Condon-Shortley phase; order -l..l within a degree). Only the first
/// [`coefficients`]`(degree)` entries are written; the others are zero.
pub(crate) fn basis(degree: usize, direction: DVec3) -> [f64; 16] {
    let DVec3 { x, y, z } = direction;
    let mut basis = [0.0; 16];
    basis[0] = SH_0;
    if degree >= 1 {
        basis[1] = -C1 * y;
        basis[2] = C1 * z;
        basis[3] = -C1 * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        basis[4] = C2 * x * y;
        basis[5] = -C2 * y * z;
        basis[6] = C20 * (2.0 * zz - xx - yy);
        basis[7] = -C2 * x * z;
        basis[8] = 0.5 * C2 * (xx - yy);
    }
    if degree >= 3 {
        basis[9] = -C33 * y * (3.0 * xx - yy);
        basis[10] = C32 * x * y * z;
        basis[11] = -C31 * y * (4.0 * zz - xx - yy);
        basis[12] = C30 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        basis[13] = -C31 * x * (4.0 * zz - xx - yy);
        basis[14] = 0.5 * C32 * z * (xx - yy);
        basis[15] = -C33 * x * (xx - 3.0 * yy);
    }
    basis
}

/// Replaces coefficients by those of the same colours turned by `rotation`, which must be one: the colour along `rotation d` is what that
/// along `d` was.
pub(crate) fn rotate(degree: usize, sh: &mut [[f32; 3]], rotation: DMat3) {
    let count = coefficients(degree);
    if degree == 0 {
        return;
    }
    // The coefficient of Y_i is the integral of the turned function times Y_i.
    let mut turn = [[0.0; 16]; 16];
    let back = rotation.transpose();
    for (direction, weight) in directions() {
        let (new, old) = (basis(degree, direction), basis(degree, back * direction));
        for (row, new) in turn.iter_mut().zip(new) {
            for (entry, old) in row.iter_mut().zip(old) {
                *entry += weight * new * old;
            }
        }
    }
    for of_one in sh.chunks_exact_mut(count) {
        let mut turned = [[0.0; 3]; 16];
        for (turned, row) in turned.iter_mut().zip(&turn) {
            for (entry, old) in row.iter().zip(of_one.iter()) {
                for (sum, old) in turned.iter_mut().zip(old) {
                    *sum += entry * f64::from(*old);
                }
            }
        }
        for (new, turned) in of_one.iter_mut().zip(turned) {
            *new = turned.map(|channel| channel as f32);
        }
    }
}

/// Turns coefficients by 180 degrees about the x axis, exactly: those of functions that are odd in y and z together change their sign.
pub(crate) fn turn_about_x(degree: usize, sh: &mut [[f32; 3]]) {
    change_signs(degree, sh, &[1, 2, 4, 7, 9, 11, 12, 14]);
}

/// As [`turn_about_x`], about the z axis.
pub(crate) fn turn_about_z(degree: usize, sh: &mut [[f32; 3]]) {
    change_signs(degree, sh, &[1, 3, 5, 7, 9, 11, 13, 15]);
}

/// Mirrors coefficients along the z axis, exactly: those of functions that are odd in z change their sign.
pub(crate) fn mirror_z(degree: usize, sh: &mut [[f32; 3]]) {
    change_signs(degree, sh, &[2, 5, 7, 10, 12, 14]);
}

fn change_signs(degree: usize, sh: &mut [[f32; 3]], coefficients_of_one: &[usize]) {
    for of_one in sh.chunks_exact_mut(coefficients(degree)) {
        for &at in coefficients_of_one {
            if let Some(coefficient) = of_one.get_mut(at) {
                *coefficient = coefficient.map(|channel| -channel);
            }
        }
    }
}

/// Directions and weights that integrate polynomials of degree 7 over the sphere exactly: Gauss-Legendre in z times equal steps in azimuth.
fn directions() -> impl Iterator<Item = (DVec3, f64)> {
    const NODES: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    ];
    NODES.into_iter().flat_map(|(z, weight)| {
        (0..8).map(move |step| {
            let azimuth = std::f64::consts::TAU * (f64::from(step) + 0.3) / 8.0;
            let radius = libm::sqrt(1.0 - z * z);
            let direction = DVec3::new(radius * libm::cos(azimuth), radius * libm::sin(azimuth), z);
            (direction, weight * std::f64::consts::TAU / 8.0)
        })
    })
}

/// Colour seen along `direction` (from the camera to the Gaussian, of any length): `max(0, 0.5 + sum)`.
#[inline]
pub(crate) fn color<T: Copy + Into<f64>>(degree: usize, sh: &[[T; 3]], direction: DVec3) -> [f64; 3] {
    let basis = basis(degree, if degree == 0 { direction } else { direction.normalize() });
    let mut color = [0.5; 3];
    for (weight, coefficient) in basis.iter().zip(sh) {
        for channel in 0..3 {
            color[channel] += weight * coefficient[channel].into();
        }
    }
    color.map(|channel| channel.max(0.0))
}

/// The backward of [`color`]: from the gradient of the colour, which is zero in a clamped channel, the factor of each
/// coefficient's gradient (its basis function), and the gradient of the direction.
pub(crate) fn color_backward<T: Copy + Into<f64>>(
    degree: usize,
    sh: &[[T; 3]],
    direction: DVec3,
    gradient: [f64; 3],
) -> ([f64; 16], DVec3) {
    if degree == 0 {
        return (basis(0, direction), DVec3::ZERO);
    }
    let length = direction.length();
    let unit = direction / length;
    let mut along = DVec3::ZERO;
    for (slope, coefficient) in basis_gradient(degree, unit).into_iter().zip(sh) {
        let weight: f64 = (0..3).map(|channel| gradient[channel] * coefficient[channel].into()).sum();
        along += weight * slope;
    }
    (basis(degree, unit), (along - along.dot(unit) * unit) / length)
}

/// The gradients of the polynomials that [`basis`] evaluates.
fn basis_gradient(degree: usize, direction: DVec3) -> [DVec3; 16] {
    let DVec3 { x, y, z } = direction;
    let mut gradient = [DVec3::ZERO; 16];
    if degree >= 1 {
        gradient[1] = -C1 * DVec3::Y;
        gradient[2] = C1 * DVec3::Z;
        gradient[3] = -C1 * DVec3::X;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        gradient[4] = C2 * DVec3::new(y, x, 0.0);
        gradient[5] = -C2 * DVec3::new(0.0, z, y);
        gradient[6] = C20 * DVec3::new(-2.0 * x, -2.0 * y, 4.0 * z);
        gradient[7] = -C2 * DVec3::new(z, 0.0, x);
        gradient[8] = C2 * DVec3::new(x, -y, 0.0);
    }
    if degree >= 3 {
        gradient[9] = -C33 * DVec3::new(6.0 * x * y, 3.0 * (xx - yy), 0.0);
        gradient[10] = C32 * DVec3::new(y * z, x * z, x * y);
        gradient[11] = -C31 * DVec3::new(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
        gradient[12] = C30 * DVec3::new(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * (xx + yy));
        gradient[13] = -C31 * DVec3::new(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
        gradient[14] = C32 * DVec3::new(x * z, -y * z, 0.5 * (xx - yy));
        gradient[15] = -C33 * DVec3::new(3.0 * (xx - yy), -6.0 * x * y, 0.0);
    }
    gradient
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn basis_is_orthonormal_on_the_sphere() {
        let mut gram = [[0.0; 16]; 16];
        for (direction, weight) in directions() {
            let values = basis(3, direction);
            for i in 0..16 {
                for j in 0..16 {
                    gram[i][j] += weight * values[i] * values[j];
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                assert!((value - f64::from(u8::from(i == j))).abs() < 1e-12, "<{i},{j}> = {value}");
            }
        }
    }

    #[test]
    fn slopes_of_the_basis_match_central_differences() {
        let at = DVec3::new(0.3, -0.7, 0.5); // the polynomials are differentiated off the unit sphere too
        let slopes = basis_gradient(3, at);
        for (axis, direction) in DVec3::AXES.into_iter().enumerate() {
            let step = direction * 1e-5;
            let (after, before) = (basis(3, at + step), basis(3, at - step));
            for i in 0..16 {
                let difference = (after[i] - before[i]) / 2e-5;
                assert!((slopes[i][axis] - difference).abs() < 1e-9, "basis {i}, axis {axis}");
            }
        }
    }

    /// The signs of the reference: degree 1 is (-y, z, -x); see `computeColorFromSH` in
    /// graphdeco-inria/diff-gaussian-rasterization cuda_rasterizer/forward.cu.
    #[test]
    fn signs_are_those_of_the_reference() {
        let signs =
            |direction: DVec3| basis(3, direction.normalize()).map(|v| if v < 0.0 { '-' } else { '+' });
        let direction = DVec3::new(0.5, 0.3, 0.8);
        assert_eq!(signs(direction).iter().collect::<String>(), "+-+-+-+-+-+-+-++");
        assert_eq!(basis(1, direction)[4..], [0.0; 12]);
    }

    #[test]
    fn color_is_half_plus_the_sum_and_never_negative() {
        let sh = [[1.0, 0.0, -3.0]];
        let [r, g, b] = color(0, &sh, DVec3::Z);
        assert!((r - 0.782_094_791_773_878_1).abs() < 1e-15);
        assert_eq!([g, b], [0.5, 0.0]);
    }

    #[test]
    fn turned_colours_are_seen_from_turned_directions() {
        let degrees = |degree: usize| -> Vec<[f32; 3]> {
            let part = |i: usize| libm::sinf(i as f32 * 1.7 + degree as f32);
            (0..2 * coefficients(degree)).map(|i| [part(3 * i), part(3 * i + 1), part(3 * i + 2)]).collect()
        };
        let [about_x, about_z] =
            [DVec3::X, DVec3::Z].map(|axis| DMat3::from_axis_angle(axis, std::f64::consts::PI));
        let any = DMat3::from_quat(glam::DQuat::from_xyzw(0.1, -0.7, 0.3, 0.6).normalize());
        let seen = DVec3::new(0.4, -0.3, 0.8).normalize();
        for degree in 0..=3 {
            let rotate_any = |degree, sh: &mut [[f32; 3]]| rotate(degree, sh, any);
            type Turn<'a> = &'a dyn Fn(usize, &mut [[f32; 3]]);
            let turns = [(any, &rotate_any as Turn), (about_x, &turn_about_x), (about_z, &turn_about_z)];
            for (rotation, turn) in turns {
                let (old, mut new) = (degrees(degree), degrees(degree));
                turn(degree, &mut new);
                let count = coefficients(degree);
                for (old, new) in old.chunks_exact(count).zip(new.chunks_exact(count)) {
                    let (old, new) = (color(degree, old, seen), color(degree, new, rotation * seen));
                    for channel in 0..3 {
                        assert!(
                            (old[channel] - new[channel]).abs() < 1e-6,
                            "degree {degree}: {old:?} {new:?}"
                        );
                    }
                }
            }
        }
    }
}
