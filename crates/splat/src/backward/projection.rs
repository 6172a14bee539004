//! From the gradients of a splat to those of its Gaussian and of the cameras.

use glam::{DMat3, DQuat, DVec2, DVec3, DVec4};

use super::entries::moment;
use crate::gradients::{CameraGradient, GaussianGradientsChunk};
use crate::projection::{Motion, Splat, View};
use crate::reference::LOW_PASS;
use crate::{Camera, Gaussians, Options, sh};

/// The inverse of the projected covariance is this times the transpose of [`Splat::factor`] times the factor.
const CONIC: f64 = 2.0 * std::f64::consts::LN_2;

/// The cameras of a rendering.
pub(super) struct ViewBackward<'a> {
    view: View,
    next: Option<(&'a Gaussians, Motion)>,
}

impl<'a> ViewBackward<'a> {
    pub(super) fn new(
        gaussians: &Gaussians,
        camera: &Camera,
        next: Option<(&'a Gaussians, Camera)>,
        options: &Options,
    ) -> Self {
        let next = next.map(|(gaussians, camera)| (gaussians, Motion::new(&camera, options.convention)));
        Self { view: View::new(camera, gaussians.antialiased), next }
    }

    /// Writes the gradients of Gaussian number `index`, given those of its splat ([`Partial::sums`](super::entries::Partial)), to
    /// entry `at` of `out`; adds those of this and the next camera to `cameras`.
    #[expect(clippy::too_many_arguments, reason = "an entry of lists of arguments")]
    pub(super) fn gaussian(
        &self,
        gaussians: &Gaussians,
        index: usize,
        splat: &Splat,
        sums: &[f32],
        out: &mut GaussianGradientsChunk<'_>,
        at: usize,
        cameras: &mut [CameraGradient; 2],
    ) {
        let View { camera, rotation: camera_from_world, .. } = &self.view;
        let [camera_gradient, next_gradient] = cameras;
        let sum = |moment: usize| f64::from(sums[moment]);
        let feature = |channel: usize| sum(moment::COUNT + channel);
        let position = gaussians.positions[index].as_dvec3();
        let point = camera.camera_from_world.transform_point3(position);

        let sh = &gaussians.sh[index * gaussians.sh_len()..][..gaussians.sh_len()];
        let lit = std::array::from_fn(|i| if splat.features[i] > 0.0 { feature(i) } else { 0.0 });
        let (basis, direction) =
            sh::color_backward(gaussians.sh_degree, sh, position - self.view.position, lit);
        for (out, weight) in out.sh[at * sh.len()..][..sh.len()].iter_mut().zip(basis) {
            *out = lit.map(|channel| (weight * channel) as f32);
        }

        let [xx, xy, yy] = splat.factor.map(f64::from);
        let blending = CONIC * DVec2::new(xx * sum(moment::E1), xy * sum(moment::E1) + yy * sum(moment::E2));
        let absolute = -CONIC * DVec2::new(xx * sum(moment::ABSOLUTE_X), sum(moment::ABSOLUTE_Y));
        out.centers[at] = blending.as_vec2();
        out.centers_absolute[at] = absolute.as_vec2();
        let mut center = blending;
        if let Some((next, motion)) = &self.next {
            let displacement = DVec2::new(feature(4), feature(5));
            let (moved, of_center) = motion.backward(
                next.positions[index].as_dvec3(),
                splat,
                displacement,
                feature(6),
                next_gradient,
            );
            out.next_positions[at] = moved.as_vec3();
            center += of_center;
        }

        // The projected covariance: minus the inverse times the gradient of the inverse times the inverse, by the factor.
        let (e11, e12, e22) = (sum(moment::E11), sum(moment::E12), sum(moment::E22));
        let half = 0.5 * CONIC * CONIC;
        let covariance = [
            half * xx * xx * e11,
            half * xx * (xy * e11 + yy * e12),
            half * (xy * xy * e11 + 2.0 * xy * yy * e12 + yy * yy * e22),
        ];
        let scale = gaussians.scales[index].as_dvec3();
        let quaternion = gaussians.rotations[index].as_dquat();
        let length = quaternion.length();
        let unit = quaternion / length;
        let axes = *camera_from_world * DMat3::from_quat(unit);
        let (x, y, z) = (axes.row(0), axes.row(1), axes.row(2));
        let direction_to = point.truncate() / point.z;
        let clamped = self.view.clamped(direction_to);
        let (fx, fy) = (camera.fx / point.z, camera.fy / point.z);
        let (across, down) = (x - clamped.x * z, y - clamped.y * z);
        let (horizontal, vertical) = (across * scale * fx, down * scale * fy);
        let mut horizontal_gradient = 2.0 * (covariance[0] * horizontal + covariance[1] * vertical);
        let mut vertical_gradient = 2.0 * (covariance[1] * horizontal + covariance[2] * vertical);
        if self.view.antialiased {
            let slopes = log_compensation_slopes(horizontal, vertical);
            horizontal_gradient += sum(moment::V) * slopes[0];
            vertical_gradient += sum(moment::V) * slopes[1];
        }
        let (across_gradient, down_gradient) =
            (horizontal_gradient * scale * fx, vertical_gradient * scale * fy);
        let scales = horizontal_gradient * across * fx + vertical_gradient * down * fy;
        out.scales[at] = scales.as_vec3();

        // A rotation of the axes about the camera's: the sum of each axis times its gradient.
        let z_gradient = -(clamped.x * across_gradient + clamped.y * down_gradient);
        let turn = DVec3::new(
            y.dot(z_gradient) - z.dot(down_gradient),
            z.dot(across_gradient) - x.dot(z_gradient),
            x.dot(down_gradient) - y.dot(across_gradient),
        );
        let world_turn = camera_from_world.transpose() * turn;
        // A turn by a small vector adds half its quaternion product with the unit quaternion; the product keeps lengths.
        let rotation = 2.0 / length * DVec4::from(DQuat::from_vec4(world_turn.extend(0.0)) * unit);
        out.rotations[at] = rotation.as_vec4();
        camera_gradient.rotation += turn;

        // The point: through the centre, the depth, and the Jacobian.
        let stretch = [horizontal_gradient.dot(horizontal), vertical_gradient.dot(vertical)];
        let mut point_gradient = camera.pixel_backward(point, center, camera_gradient);
        point_gradient.z += feature(3) - (stretch[0] + stretch[1]) / point.z;
        camera_gradient.fx += stretch[0] / camera.fx;
        camera_gradient.fy += stretch[1] / camera.fy;
        let along = -DVec2::new(across_gradient.dot(z), down_gradient.dot(z));
        if clamped.x == direction_to.x {
            point_gradient.x += along.x / point.z;
            point_gradient.z -= along.x * direction_to.x / point.z;
        } else {
            camera_gradient.cx -= along.x / camera.fx;
            camera_gradient.fx -= along.x * clamped.x / camera.fx;
        }
        if clamped.y == direction_to.y {
            point_gradient.y += along.y / point.z;
            point_gradient.z -= along.y * direction_to.y / point.z;
        } else {
            camera_gradient.cy -= along.y / camera.fy;
            camera_gradient.fy -= along.y * clamped.y / camera.fy;
        }
        camera_gradient.translation += point_gradient + *camera_from_world * direction;
        camera_gradient.rotation += point.cross(point_gradient);
        let moved = camera_from_world.transpose() * point_gradient + direction;
        out.positions[at] = moved.as_vec3();
        out.opacities[at] = (sum(moment::V) / f64::from(gaussians.opacities[index])) as f32;
    }
}

/// The derivatives of the natural logarithm of the opacity's factor ([`Gaussians::antialiased`]) with respect to the two rows
/// whose inner products are the projected covariance.
fn log_compensation_slopes(horizontal: DVec3, vertical: DVec3) -> [DVec3; 2] {
    let normal = horizontal.cross(vertical);
    let sharp_determinant = normal.length_squared();
    let added = LOW_PASS * (horizontal.length_squared() + vertical.length_squared()) + LOW_PASS * LOW_PASS;
    let determinant = sharp_determinant + added;
    // Not zero: the factor of a splat that is drawn is at least 1/255 of its opacity.
    let area = added / determinant / sharp_determinant;
    let trace = LOW_PASS / determinant;
    [area * vertical.cross(normal) - trace * horizontal, area * normal.cross(horizontal) - trace * vertical]
}

impl Motion {
    /// The backward of [`Motion::apply`]: the gradients of the moved position, and of the centre in this frame.
    fn backward(
        &self,
        position: DVec3,
        splat: &Splat,
        displacement: DVec2,
        depth: f64,
        out: &mut CameraGradient,
    ) -> (DVec3, DVec2) {
        let camera = &self.camera;
        let point = self.camera_from_world.transform_point3(position);
        if !point.is_finite() {
            return (DVec3::ZERO, DVec2::ZERO);
        }
        let mut gradient = DVec3::ZERO;
        let mut center = DVec2::ZERO;
        if self.displacement(point, splat).is_some() {
            let pixel = displacement * self.scale;
            center = -pixel;
            gradient = camera.pixel_backward(point, pixel, out);
        }
        if (point.z as f32).is_finite() {
            gradient.z += depth;
        }
        out.translation += gradient;
        out.rotation += point.cross(gradient);
        (DMat3::from_mat4(self.camera_from_world).transpose() * gradient, center)
    }
}
