//! The gradients against central differences in `f64`.

use glam::{DMat3, DMat4, DQuat, DVec3, Vec3};
use srflow_core::Size;

use super::*;
use crate::gradients::{CameraGradient, FrameGradients};
use crate::tests::scenes::{camera, gradients, jittered, moved, random};
use crate::{Gaussians, PixelConvention};

/// `sum of gradient times output`, whose gradients with respect to the outputs are the given ones.
fn loss(pixels: &[Pixel], gradients: &FrameGradients) -> f64 {
    let mut loss = 0.0;
    for (i, pixel) in pixels.iter().enumerate() {
        for channel in 0..3 {
            loss += pixel.color[channel] * f64::from(gradients.color[i][channel]);
        }
        for channel in 0..2 {
            loss += pixel.flow[channel] * f64::from(gradients.flow[i][channel]);
        }
        loss += pixel.alpha * f64::from(gradients.alpha[i])
            + pixel.depth * f64::from(gradients.depth[i])
            + pixel.depth_next * f64::from(gradients.depth_next[i]);
    }
    loss
}

/// A parameter's name, its gradient, and how to change it by a number.
type Parameter = (String, f64, Box<dyn Fn(&mut Scene, f64)>);

fn parameters(scene: &Scene, gradients: &Gradients) -> Vec<Parameter> {
    let mut all: Vec<Parameter> = Vec::new();
    for i in 0..scene.positions.len() {
        for axis in 0..3 {
            all.push((
                format!("position {i}, {axis}"),
                gradients.positions[i][axis],
                Box::new(move |scene, step| scene.positions[i][axis] += step),
            ));
            all.push((
                format!("scale {i}, {axis}"),
                gradients.scales[i][axis],
                Box::new(move |scene, step| scene.scales[i][axis] += step),
            ));
            if scene.next.is_some() {
                all.push((
                    format!("next position {i}, {axis}"),
                    gradients.next_positions[i][axis],
                    Box::new(move |scene, step| scene.next.as_mut().unwrap().0[i][axis] += step),
                ));
            }
        }
        for entry in 0..4 {
            let change = move |scene: &mut Scene, step: f64| {
                let mut quaternion = scene.rotations[i].to_array();
                quaternion[entry] += step;
                scene.rotations[i] = DQuat::from_array(quaternion);
            };
            all.push((format!("quaternion {i}, {entry}"), gradients.rotations[i][entry], Box::new(change)));
        }
        let change = move |scene: &mut Scene, step: f64| scene.opacities[i] += step;
        all.push((format!("opacity {i}"), gradients.opacities[i], Box::new(change)));
    }
    for i in 0..scene.sh.len() {
        for channel in 0..3 {
            all.push((
                format!("coefficient {i}, {channel}"),
                gradients.sh[i][channel],
                Box::new(move |scene, step| scene.sh[i][channel] += step),
            ));
        }
    }
    camera_parameters(&mut all, "camera", &gradients.camera, |scene| &mut scene.camera);
    if scene.next.is_some() {
        camera_parameters(&mut all, "next camera", &gradients.next_camera, |scene| {
            &mut scene.next.as_mut().unwrap().1
        });
    }
    all
}

fn camera_parameters(
    all: &mut Vec<Parameter>,
    name: &str,
    gradient: &CameraGradient,
    camera: fn(&mut Scene) -> &mut Camera,
) {
    for axis in 0..3 {
        all.push((
            format!("{name}: translation {axis}"),
            gradient.translation[axis],
            Box::new(move |scene, step| {
                let pose = &mut camera(scene).camera_from_world;
                *pose = DMat4::from_translation(DVec3::AXES[axis] * step) * *pose;
            }),
        ));
        all.push((
            format!("{name}: rotation {axis}"),
            gradient.rotation[axis],
            Box::new(move |scene, step| {
                let pose = &mut camera(scene).camera_from_world;
                *pose = DMat4::from_mat3(DMat3::from_axis_angle(DVec3::AXES[axis], step)) * *pose;
            }),
        ));
    }
    all.push((format!("{name}: fx"), gradient.fx, Box::new(move |scene, step| camera(scene).fx += step)));
    all.push((format!("{name}: fy"), gradient.fy, Box::new(move |scene, step| camera(scene).fy += step)));
    all.push((format!("{name}: cx"), gradient.cx, Box::new(move |scene, step| camera(scene).cx += step)));
    all.push((format!("{name}: cy"), gradient.cy, Box::new(move |scene, step| camera(scene).cy += step)));
}

/// Compares every gradient of a scene with the central difference of its parameter. A difference across a decision (a Gaussian
/// that is blended at a pixel on one side alone) has no limit and is left out; there may be few. Returns the number of
/// compared gradients that are not zero.
#[track_caller]
fn assert_gradients(scene: &Scene, seed: u64) -> usize {
    let gradients = gradients(scene.camera.size().pixels(), seed);
    let found = scene.backward(&gradients);
    let (mut compared, mut left_out, mut nonzero) = (0, 0, 0);
    for (name, gradient, change) in parameters(scene, &found) {
        let at = |step: f64| {
            let mut scene = scene.clone();
            change(&mut scene, step);
            scene.render()
        };
        let step = 1e-6;
        let (before, after) = (at(-step), at(step));
        if before.iter().zip(&after).any(|(before, after)| before.blended != after.blended) {
            left_out += 1;
            continue;
        }
        let difference = (loss(&after, &gradients) - loss(&before, &gradients)) / (2.0 * step);
        let error = (difference - gradient).abs();
        assert!(
            error <= 1e-6 * gradient.abs() + 2e-5,
            "{name}: {gradient}, by differences {difference}, error {error:e}"
        );
        compared += 1;
        nonzero += usize::from(gradient != 0.0);
    }
    assert!(left_out * 20 <= compared, "{left_out} left out, {compared} compared");
    nonzero
}

fn scene(gaussians: &Gaussians, next: Option<Next<'_>>, options: &Options) -> Scene {
    Scene::new(gaussians, &small(), next, options).unwrap()
}

/// An image of few pixels, its principal point off-centre.
fn small() -> Camera {
    camera().resized(Size::new(38, 27))
}

#[test]
fn gradients_of_random_scenes_match_central_differences() {
    let mut nonzero = 0;
    for seed in 0..12 {
        let degree = seed as usize % 4;
        let mut gaussians = random(seed, 14, degree);
        gaussians.antialiased = seed / 4 == 1;
        let moved_gaussians = jittered(&gaussians, seed, 0.05);
        let second = Camera { fx: 42.0, ..moved(small(), 0.05, -0.03, DVec3::new(0.05, 0.02, -0.1)) };
        let convention = [PixelConvention::Splat, PixelConvention::Paper][seed as usize % 2];
        let sorting = if seed >= 8 { Sorting::PerPixel } else { Sorting::Global };
        let options = Options { background: [0.2, 0.9, 0.4], convention, sorting, ..Options::default() };
        let next = Next { gaussians: &moved_gaussians, camera: &second };
        let mut scene = scene(&gaussians, Some(next), &options);
        scene.camera = moved(scene.camera, -0.1, 0.05, DVec3::new(0.1, 0.0, 0.2));
        // The length of a quaternion does not matter, but scales its gradient.
        scene.rotations[1] *= 1.7;
        nonzero += assert_gradients(&scene, seed);
    }
    assert!(nonzero > 2200, "only {nonzero} gradients are not zero");
}

/// The Jacobian's direction is clamped for a centre far outside the image: at each border, and at a corner.
#[test]
fn gradients_beyond_every_border_match_central_differences() {
    for (x, y) in [(1.1, 0.1), (-1.2, 0.0), (0.1, 0.9), (0.0, -1.1), (1.0, 1.0)] {
        let mut gaussians = random(3, 3, 1);
        gaussians.positions = vec![Vec3::new(x, y, 1.0), Vec3::new(1.1 * x, y, 1.1), Vec3::new(x, y, 1.4)];
        gaussians.scales.fill(Vec3::new(0.4, 0.5, 0.7));
        gaussians.opacities = vec![0.8, 0.9, 0.7];
        for antialiased in [false, true] {
            gaussians.antialiased = antialiased;
            let next = Next { gaussians: &gaussians, camera: &small() };
            assert!(assert_gradients(&scene(&gaussians, Some(next), &Options::default()), 5) > 50);
        }
    }
}

/// Needles, discs seen from their edge and balls, down to sizes at which antialiasing leaves hardly any opacity.
#[test]
fn gradients_of_antialiased_gaussians_smaller_than_a_pixel_match_central_differences() {
    let mut nonzero = 0;
    for (seed, size) in [0.002, 0.005, 0.02, 0.1].into_iter().enumerate() {
        let mut gaussians = random(seed as u64, 9, 1);
        for i in 0..gaussians.len() {
            gaussians.positions[i] =
                Vec3::new(0.06 * i as f32 - 0.2, 0.03 * (i % 4) as f32, 0.9 + 0.1 * i as f32);
            gaussians.opacities[i] = 0.9;
            gaussians.scales[i] =
                size * [Vec3::ONE, Vec3::new(1.0, 0.1, 0.2), Vec3::new(1.0, 0.8, 0.05)][i % 3];
        }
        gaussians.antialiased = true;
        let next = Next { gaussians: &gaussians, camera: &small() };
        nonzero += assert_gradients(&scene(&gaussians, Some(next), &Options::default()), seed as u64);
    }
    assert!(nonzero > 300, "only {nonzero} gradients are not zero");
}

#[test]
fn saturated_pixels_pass_no_gradient_to_the_shape() {
    let mut gaussians = random(3, 1, 0);
    gaussians.positions = vec![Vec3::new(0.0, 0.0, 1.0)];
    gaussians.scales = vec![Vec3::splat(50.0)];
    gaussians.opacities = vec![1.0];
    let scene = scene(&gaussians, None, &Options::default());
    let found = scene.backward(&gradients(scene.camera.size().pixels(), 1));
    assert_eq!((found.opacities[0], found.scales[0]), (0.0, DVec3::ZERO));
    assert!(found.sh[0].iter().all(|gradient| *gradient != 0.0));
    assert!(assert_gradients(&scene, 1) > 0);
}

/// A Gaussian without a displacement still has a depth in the next camera.
#[test]
fn gradients_behind_the_next_camera_match_central_differences() {
    let gaussians = random(11, 6, 0);
    let next = Camera { fx: 30.0, ..moved(small(), 0.1, 0.0, DVec3::new(0.0, 0.1, -2.0)) };
    let next = Next { gaussians: &gaussians, camera: &next };
    assert!(assert_gradients(&scene(&gaussians, Some(next), &Options::default()), 2) > 20);
}

/// What adaptive density control measures: the gradient of the centre on the image, with its sum of absolute values per pixel.
#[test]
fn gradients_of_centers_are_sums_over_pixels() {
    let gaussians = random(5, 30, 0);
    let scene = scene(&gaussians, None, &Options::default());
    let all = gradients(scene.camera.size().pixels(), 3);
    let whole = scene.backward(&all);
    let (mut sum, mut absolute) = (vec![DVec2::ZERO; 30], vec![DVec2::ZERO; 30]);
    for pixel in 0..all.alpha.len() {
        let mut one = FrameGradients { color: vec![[0.0; 3]; all.color.len()], ..FrameGradients::default() };
        one.color[pixel] = all.color[pixel];
        let found = scene.backward(&one);
        for i in 0..30 {
            assert!((found.centers[i].abs() - found.centers_absolute[i]).abs().max_element() < 1e-12);
            sum[i] += found.centers[i];
            absolute[i] += found.centers_absolute[i];
        }
    }
    let colors = scene.backward(&FrameGradients { color: all.color, ..FrameGradients::default() });
    for i in 0..30 {
        assert!((colors.centers[i] - sum[i]).length() < 1e-9);
        assert!((colors.centers_absolute[i] - absolute[i]).length() < 1e-9);
    }
    assert!(whole.centers_absolute.iter().filter(|center| center.x > 0.0).count() > 8);
}

#[test]
fn lists_that_do_not_fit_the_image_are_refused() {
    let gaussians = random(1, 2, 0);
    let short = FrameGradients { alpha: vec![0.0; 5], ..FrameGradients::default() };
    let error = backward(&gaussians, &small(), None, &Options::default(), &short).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the gradients: alpha has 5 entries, an image of 38x27 (WIDTHxHEIGHT) needs 1026 or none"
    );
}
