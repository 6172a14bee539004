//! The exact derivative of [`render`](super::render), term by term in the order of the chain rule.
//!
//! The equations are those of the 3DGS reference (graphdeco-inria/diff-gaussian-rasterization, `cuda_rasterizer/backward.cu`),
//! except where it does not differentiate its own forward: it passes the gradient through the limit of alpha, and through the
//! depth where the Jacobian's direction is clamped. The normalisation of quaternions is differentiated here too.
//!
//! Decisions have no gradient: which Gaussians are blended at a pixel, and their order.

use glam::{DMat2, DMat3, DQuat, DVec2, DVec3, DVec4};

use super::{
    ALPHA_MAX, LOW_PASS, Projection, Scene, Splat, compensation, projection, unclamped_alpha, world_from_axes,
};
use crate::gradients::{CameraGradient, FrameGradients};
use crate::{Camera, Gaussians, NEAR, Next, Options, RasterizeError, sh};

/// [`GaussianGradients`](crate::GaussianGradients) in `f64`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gradients {
    pub positions: Vec<DVec3>,
    pub scales: Vec<DVec3>,
    pub rotations: Vec<DVec4>,
    pub opacities: Vec<f64>,
    pub sh: Vec<[f64; 3]>,
    pub next_positions: Vec<DVec3>,
    pub centers: Vec<DVec2>,
    pub centers_absolute: Vec<DVec2>,
    pub camera: CameraGradient,
    pub next_camera: CameraGradient,
}

/// The gradients of a loss, given its gradients with respect to the pixels that [`render`](super::render) returns.
///
/// # Errors
/// As [`render`](super::render), and when a list of `gradients` does not fit the image.
pub fn backward(
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
    options: &Options,
    gradients: &FrameGradients,
) -> Result<Gradients, RasterizeError> {
    let scene = Scene::new(gaussians, camera, next, options)?;
    gradients.validate(camera.size())?;
    Ok(scene.backward(gradients))
}

/// Gradients with respect to a [`Splat`].
#[derive(Debug, Clone, Copy, Default)]
struct SplatGradient {
    center: DVec2,
    center_absolute: DVec2,
    conic: [f64; 3],
    opacity: f64,
    features: [f64; 7],
}

/// What is blended: red, green, blue, depth, displacement, next depth.
fn features(splat: &Splat) -> [f64; 7] {
    let ([r, g, b], displacement) = (splat.color, splat.displacement);
    [r, g, b, splat.depth, displacement.x, displacement.y, splat.depth_next]
}

fn dot(a: [f64; 7], b: [f64; 7]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Scene {
    pub(super) fn backward(&self, gradients: &FrameGradients) -> Gradients {
        let splats = self.splats();
        let mut splat_gradients = vec![SplatGradient::default(); self.positions.len()];
        for (pixel, at) in self.places().enumerate() {
            self.blend_backward(&splats, at, gradients, pixel, &mut splat_gradients);
        }
        let n = self.positions.len();
        let mut out = Gradients {
            positions: vec![DVec3::ZERO; n],
            scales: vec![DVec3::ZERO; n],
            rotations: vec![DVec4::ZERO; n],
            opacities: vec![0.0; n],
            sh: vec![[0.0; 3]; self.sh.len()],
            next_positions: vec![DVec3::ZERO; if self.next.is_some() { n } else { 0 }],
            centers: splat_gradients.iter().map(|gradient| gradient.center).collect(),
            centers_absolute: splat_gradients.iter().map(|gradient| gradient.center_absolute).collect(),
            camera: CameraGradient::default(),
            next_camera: CameraGradient::default(),
        };
        for splat in &splats {
            self.project_backward(splat, splat_gradients[splat.index], &mut out);
        }
        out
    }

    /// Adds what one pixel contributes to the gradients of the splats, which are listed by index of the Gaussian.
    fn blend_backward(
        &self,
        splats: &[Splat],
        at: DVec2,
        gradients: &FrameGradients,
        pixel: usize,
        out: &mut [SplatGradient],
    ) {
        let mut blended = Vec::new();
        let transmittance = self.for_each_blended(splats, at, |splat, alpha, transmittance| {
            blended.push((splat, alpha, transmittance));
        });
        if blended.is_empty() {
            return;
        }
        let color = gradients.color.get(pixel).copied().unwrap_or_default().map(f64::from);
        let depth = f64::from(gradients.depth.get(pixel).copied().unwrap_or_default());
        let flow = gradients.flow.get(pixel).copied().unwrap_or_default().map(f64::from);
        let depth_next = f64::from(gradients.depth_next.get(pixel).copied().unwrap_or_default());

        // With respect to the weighted sums of the features, and to the final transmittance. A depth is a sum over alpha.
        let alpha = 1.0 - transmittance;
        let sums = [color[0], color[1], color[2], depth / alpha, flow[0], flow[1], depth_next / alpha];
        let mean = |channel: usize| {
            blended.iter().map(|(splat, alpha, t)| t * alpha * features(splat)[channel]).sum::<f64>() / alpha
        };
        let mut behind = -f64::from(gradients.alpha.get(pixel).copied().unwrap_or_default())
            + (depth * mean(3) + depth_next * mean(6)) / alpha;
        for (color, background) in color.iter().zip(self.options.background) {
            behind += color * f64::from(background);
        }

        // `behind` is the gradient with respect to the transmittance after the splat: the blend of all that is behind it.
        for &(splat, alpha, transmittance) in blended.iter().rev() {
            let out = &mut out[splat.index];
            for (gradient, sum) in out.features.iter_mut().zip(sums) {
                *gradient += transmittance * alpha * sum;
            }
            let own = dot(features(splat), sums);
            let alpha_gradient = transmittance * (own - behind);
            behind = alpha * own + (1.0 - alpha) * behind;
            let d = at - splat.center;
            if unclamped_alpha(splat, d) > ALPHA_MAX {
                continue;
            }
            out.opacity += alpha_gradient * alpha / splat.opacity;
            let power_gradient = alpha_gradient * alpha;
            let [xx, xy, yy] = splat.conic;
            let center = power_gradient * DVec2::new(xx * d.x + xy * d.y, xy * d.x + yy * d.y);
            out.center += center;
            out.center_absolute += center.abs();
            out.conic[0] -= 0.5 * power_gradient * d.x * d.x;
            out.conic[1] -= power_gradient * d.x * d.y;
            out.conic[2] -= 0.5 * power_gradient * d.y * d.y;
        }
    }

    fn project_backward(&self, splat: &Splat, gradient: SplatGradient, out: &mut Gradients) {
        let (index, camera) = (splat.index, &self.camera);
        let position = self.positions[index];
        let point = camera.camera_from_world.transform_point3(position);
        let camera_from_world = DMat3::from_mat4(camera.camera_from_world);
        let [r, g, b, depth, u, v, depth_next] = gradient.features;

        // Colour: its direction depends on the positions of the Gaussian and of the camera.
        let lit = std::array::from_fn(|i| if splat.color[i] > 0.0 { [r, g, b][i] } else { 0.0 });
        let direction = position - camera.position();
        let (basis, direction) = sh::color_backward(self.sh_degree, self.sh(index), direction, lit);
        let each = self.sh(index).len();
        for (out, weight) in out.sh[index * each..][..each].iter_mut().zip(basis) {
            *out = lit.map(|channel| weight * channel);
        }
        out.positions[index] += direction;
        out.camera.translation += camera_from_world * direction;

        // Motion.
        let mut center = gradient.center;
        if let Some((positions, next)) = &self.next {
            let next_point = next.camera_from_world.transform_point3(positions[index]);
            // A moved position that is not finite has no gradient.
            if next_point.is_finite() {
                let mut point_gradient = DVec3::ZERO;
                if next_point.z > NEAR {
                    let displacement = DVec2::new(u, v) * self.flow_scale(next);
                    center -= displacement;
                    point_gradient = next.pixel_backward(next_point, displacement, &mut out.next_camera);
                }
                point_gradient.z += depth_next;
                out.next_positions[index] =
                    point_backward(next, next_point, point_gradient, &mut out.next_camera);
            }
        }

        // Centre and depth.
        let mut point_gradient = camera.pixel_backward(point, center, &mut out.camera);
        point_gradient.z += depth;

        // From the inverse of the projected covariance, C, to the covariance: d(C) = -C d(covariance) C.
        let conic = symmetric(splat.conic);
        let [xx, xy, yy] = gradient.conic;
        let covariance = -(conic * symmetric([xx, 0.5 * xy, yy]) * conic);
        // To the rows of J W, whose inner products it has.
        let axes = world_from_axes(self.rotations[index], self.scales[index]);
        let projection = projection(camera, point, axes);
        let rows = projection.rows;
        let mut row_gradients =
            [0, 1].map(|i| 2.0 * (covariance.col(i).x * rows[0] + covariance.col(i).y * rows[1]));
        out.opacities[index] = gradient.opacity;
        if self.antialiased {
            // The opacity on the image is the Gaussian's times the compensation.
            out.opacities[index] *= compensation(&projection);
            let slopes = compensation_slopes(&projection);
            for (row, slope) in row_gradients.iter_mut().zip(slopes) {
                *row += gradient.opacity * self.opacities[index] * slope;
            }
        }
        let Projection { direction, clamped, jacobian_rows, camera_from_axes, .. } = projection;
        // To J and W.
        let jacobian = row_gradients.map(|row| camera_from_axes * row);
        let camera_from_axes_gradient = DMat3::from_cols_array_2d(&std::array::from_fn(|axis| {
            (jacobian_rows[0] * row_gradients[0][axis] + jacobian_rows[1] * row_gradients[1][axis]).to_array()
        }));
        // J: [fx, 0, -fx x] / z and [0, fy, -fy y] / z.
        point_gradient.z -= (jacobian[0].dot(jacobian_rows[0]) + jacobian[1].dot(jacobian_rows[1])) / point.z;
        out.camera.fx += (jacobian[0].x - jacobian[0].z * clamped.x) / point.z;
        out.camera.fy += (jacobian[1].y - jacobian[1].z * clamped.y) / point.z;
        let along_x = -camera.fx / point.z * jacobian[0].z;
        let along_y = -camera.fy / point.z * jacobian[1].z;
        if clamped.x == direction.x {
            point_gradient.x += along_x / point.z;
            point_gradient.z -= along_x * direction.x / point.z;
        } else {
            // The bound is (constant - cx) / fx.
            out.camera.cx -= along_x / camera.fx;
            out.camera.fx -= along_x * clamped.x / camera.fx;
        }
        if clamped.y == direction.y {
            point_gradient.y += along_y / point.z;
            point_gradient.z -= along_y * direction.y / point.z;
        } else {
            out.camera.cy -= along_y / camera.fy;
            out.camera.fy -= along_y * clamped.y / camera.fy;
        }
        // W: a rotation of the camera turns each axis.
        for axis in 0..3 {
            out.camera.rotation += camera_from_axes.col(axis).cross(camera_from_axes_gradient.col(axis));
        }
        let axes_gradient = camera_from_world.transpose() * camera_from_axes_gradient;
        let rotation = DMat3::from_quat(self.rotations[index].normalize());
        for axis in 0..3 {
            out.scales[index][axis] = rotation.col(axis).dot(axes_gradient.col(axis));
        }
        let rotation_gradient = axes_gradient * DMat3::from_diagonal(self.scales[index]);
        out.rotations[index] = quaternion_backward(self.rotations[index], rotation_gradient);

        out.positions[index] += point_backward(camera, point, point_gradient, &mut out.camera);
    }
}

/// The derivatives of [`compensation`] with respect to the two rows. With `n` their cross product, it is `|n| / sqrt(d)`, where
/// `d = n . n + LOW_PASS (r0 . r0 + r1 . r1) + LOW_PASS^2`.
fn compensation_slopes(Projection { rows, .. }: &Projection) -> [DVec3; 2] {
    let normal = rows[0].cross(rows[1]);
    let length = normal.length();
    let determinant = normal.length_squared()
        + LOW_PASS * (rows[0].length_squared() + rows[1].length_squared())
        + LOW_PASS * LOW_PASS;
    // d |n| / d r0 is r1 x n / |n|. The length of a Gaussian that is drawn is not zero, and this has length |r1| however small
    // that is.
    let length_slopes = [rows[1].cross(normal) / length, normal.cross(rows[0]) / length];
    [0, 1].map(|i| {
        let determinant_slope = 2.0 * length * length_slopes[i] + 2.0 * LOW_PASS * rows[i];
        length_slopes[i] / determinant.sqrt()
            - 0.5 * length * determinant_slope / (determinant * determinant.sqrt())
    })
}

fn symmetric([xx, xy, yy]: [f64; 3]) -> DMat2 {
    DMat2::from_cols_array(&[xx, xy, xy, yy])
}

/// From the gradient of a point in camera coordinates to that of the point in the world, and to those of the pose, which are
/// added to `out`.
fn point_backward(camera: &Camera, point: DVec3, gradient: DVec3, out: &mut CameraGradient) -> DVec3 {
    out.translation += gradient;
    out.rotation += point.cross(gradient);
    DMat3::from_mat4(camera.camera_from_world).transpose() * gradient
}

/// From the gradient of a rotation matrix to that of the quaternion, of any length, whose direction it is.
fn quaternion_backward(quaternion: DQuat, gradient: DMat3) -> DVec4 {
    let DQuat { x, y, z, w } = quaternion.normalize();
    let by = |columns: [[f64; 3]; 3]| {
        let slope = DMat3::from_cols_array_2d(&columns).to_cols_array();
        slope.iter().zip(gradient.to_cols_array()).map(|(a, b)| a * b).sum::<f64>() * 2.0
    };
    let unit = DVec4::new(
        by([[0.0, y, z], [y, -2.0 * x, w], [z, -w, -2.0 * x]]),
        by([[-2.0 * y, x, -w], [x, 0.0, z], [w, z, -2.0 * y]]),
        by([[-2.0 * z, w, x], [-w, -2.0 * z, y], [x, y, 0.0]]),
        by([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]),
    );
    let direction = DVec4::new(x, y, z, w);
    (unit - unit.dot(direction) * direction) / quaternion.length()
}
