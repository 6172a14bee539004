//! The fast gradients against the reference.

use glam::{DVec3, Quat, Vec3};
use srflow_simd::Isa;

use super::scenes::{camera, gradients, jittered, moved, push, push_each, random};
use crate::reference::{self, Gradients};
use crate::{
    Camera, CameraGradient, Frame, FrameGradients, GaussianGradients, Gaussians, Next, Options, Outputs,
    Rasterizer, Sorting,
};

const OPTIONS: Options = Options {
    background: [0.1, 0.5, 0.9],
    convention: crate::PixelConvention::Paper,
    sorting: Sorting::Global,
    outputs: Outputs::NONE,
};

const PER_PIXEL: Options = Options { sorting: Sorting::PerPixel, ..OPTIONS };

fn fast(
    rasterizer: &mut Rasterizer,
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
    options: &Options,
    gradients: &FrameGradients,
) -> GaussianGradients {
    let mut out = GaussianGradients::default();
    let mut rendering = rasterizer.render(gaussians, camera, next, options, &mut Frame::new()).unwrap();
    rendering.backward(gradients, &mut out).unwrap();
    out
}

fn lists(found: &GaussianGradients, expected: &Gradients) -> Vec<(&'static str, usize, Vec<f64>, Vec<f64>)> {
    macro_rules! list {
        ($name:ident, $each:expr, $value:ident) => {
            (
                stringify!($name),
                $each,
                found.$name.iter().flat_map(|$value| $value.to_array()).map(f64::from).collect(),
                expected.$name.iter().flat_map(|$value| $value.to_array()).collect(),
            )
        };
    }
    let camera = |camera: &CameraGradient| {
        let CameraGradient { translation, rotation, fx, fy, cx, cy } = *camera;
        [translation.to_array().to_vec(), rotation.to_array().to_vec(), vec![fx, fy, cx, cy]].concat()
    };
    vec![
        list!(positions, 3, v),
        list!(scales, 3, v),
        list!(rotations, 4, v),
        list!(next_positions, 3, v),
        list!(centers, 2, v),
        list!(centers_absolute, 2, v),
        (
            "opacities",
            1,
            found.opacities.iter().copied().map(f64::from).collect(),
            expected.opacities.clone(),
        ),
        (
            "sh",
            3,
            found.sh.as_flattened().iter().copied().map(f64::from).collect(),
            expected.sh.as_flattened().to_vec(),
        ),
        ("camera", 10, camera(&found.camera), camera(&expected.camera)),
        ("next camera", 10, camera(&found.next_camera), camera(&expected.next_camera)),
    ]
}

/// All lists in one.
fn lists_of(found: &GaussianGradients) -> Vec<f64> {
    lists(found, &Gradients::default()).into_iter().flat_map(|(_, _, found, _)| found).collect()
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

/// Compares each list: its error within 3e-4 of its norm (what the `f32` sums of needles of 1:300 need), and that of each
/// Gaussian within 1 % of its own gradient.
#[track_caller]
fn assert_close(found: &GaussianGradients, expected: &Gradients) {
    for (name, each, found, expected) in lists(found, expected) {
        assert_eq!(found.len(), expected.len(), "{name}");
        let error: Vec<f64> = found.iter().zip(&expected).map(|(a, b)| a - b).collect();
        let whole = norm(&expected);
        assert!(norm(&error) <= 3e-4 * whole + 1e-12, "{name}: error {:e} of {whole:e}", norm(&error));
        for (i, (error, expected)) in error.chunks(each).zip(expected.chunks(each)).enumerate() {
            let (error, own) = (norm(error), norm(expected));
            assert!(error <= 1e-2 * own + 1e-7 * whole + 1e-12, "{name} {i}: error {error:e} of {own:e}");
        }
    }
}

#[track_caller]
fn assert_agree(
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
    options: &Options,
    gradients: &FrameGradients,
) -> GaussianGradients {
    let found = fast(&mut Rasterizer::new(), gaussians, camera, next, options, gradients);
    assert_close(&found, &reference::backward(gaussians, camera, next, options, gradients).unwrap());
    found
}

fn second() -> Camera {
    Camera { fx: 95.0, ..moved(camera(), 0.05, -0.03, DVec3::new(0.05, 0.02, -0.1)) }
}

/// Large, tiny, beyond the border, behind the camera, saturated, transparent, of every degree.
#[test]
fn gradients_of_random_scenes_agree() {
    for seed in 0..16 {
        let count = [3, 30, 120, 400][seed as usize % 4];
        let gaussians = random(seed, count, seed as usize / 4);
        let moved_gaussians = jittered(&gaussians, seed, 0.02);
        let next = Next { gaussians: &moved_gaussians, camera: &second() };
        let all = gradients(camera().size().pixels(), seed);
        let found = assert_agree(&gaussians, &camera(), Some(next), &OPTIONS, &all);
        let nonzero = found.positions.iter().filter(|gradient| **gradient != Vec3::ZERO).count();
        assert!(nonzero * 8 >= count, "{nonzero} of {count} have a gradient");

        // Fewer outputs with gradients, in every combination that is computed differently.
        let none = FrameGradients::default();
        let color = FrameGradients { color: all.color.clone(), ..none.clone() };
        let depth = FrameGradients { depth: all.depth.clone(), alpha: all.alpha.clone(), ..none.clone() };
        let flow = FrameGradients { flow: all.flow.clone(), ..none.clone() };
        for some in [&none, &color, &depth, &flow, &all] {
            assert_agree(&gaussians, &camera(), Some(next), &OPTIONS, some);
            assert_agree(&gaussians, &camera(), None, &OPTIONS, some);
            assert_agree(&gaussians, &camera(), Some(next), &PER_PIXEL, some);
        }
        let antialiased = Gaussians { antialiased: true, ..gaussians };
        assert_agree(&antialiased, &camera(), Some(next), &OPTIONS, &all);
    }
}

/// Gaussians across so many rows of tiles that no list per row is made.
#[test]
fn gradients_in_a_tall_image_agree() {
    let tall = Camera { width: 21, height: 611, cx: 9.0, cy: 320.0, fy: 700.0, ..camera() };
    let mut gaussians = random(6, 9, 2);
    for position in &mut gaussians.positions {
        position.z = position.z.abs() + 0.5;
    }
    gaussians.scales.fill(Vec3::new(0.2, 2.0, 0.3));
    gaussians.rotations.fill(Quat::from_rotation_z(0.1));
    assert_agree(&gaussians, &tall, None, &OPTIONS, &gradients(21 * 611, 1));
}

#[test]
fn a_gaussian_that_is_not_visible_has_no_gradient() {
    let mut gaussians = random(8, 40, 1);
    let hidden = gaussians.len();
    push(&mut gaussians, Vec3::new(0.0, 0.0, -1.0), Vec3::splat(0.1), Quat::IDENTITY, 0.9, [0.5; 3]);
    push(&mut gaussians, Vec3::new(0.0, f32::NAN, 1.0), Vec3::splat(0.1), Quat::IDENTITY, 0.9, [0.5; 3]);
    push(&mut gaussians, Vec3::new(0.0, 9.0, 1.0), Vec3::splat(0.1), Quat::IDENTITY, 0.9, [0.5; 3]);
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::new();
    let mut rendering = rasterizer.render(&gaussians, &camera(), None, &OPTIONS, &mut frame).unwrap();
    let visible: Vec<bool> = rendering.visible().collect();
    assert_eq!(visible.iter().filter(|visible| **visible).count(), frame.statistics.visible);
    let mut out = GaussianGradients::default();
    rendering.backward(&gradients(camera().size().pixels(), 4), &mut out).unwrap();
    for i in (0..gaussians.len()).filter(|&i| !visible[i]) {
        assert_eq!((out.positions[i], out.opacities[i]), (Vec3::ZERO, 0.0));
        assert_eq!(out.sh[i * 4..][..4], [[0.0; 3]; 4]);
    }
    assert!(!visible[hidden..].contains(&true));
}

/// More Gaussians than a chunk, an image of many tiles.
fn large(rasterizer: &mut Rasterizer, options: &Options, seed: u64) -> GaussianGradients {
    let wide = Camera { width: 333, height: 217, fx: 300.0, fy: 310.0, cx: 150.0, cy: 110.0, ..camera() };
    let gaussians = random(seed, 3000, 3);
    let moved_gaussians = jittered(&gaussians, seed, 0.03);
    let next = Next { gaussians: &moved_gaussians, camera: &Camera { fx: 305.0, ..wide } };
    fast(rasterizer, &gaussians, &wide, Some(next), options, &gradients(333 * 217, seed))
}

#[test]
fn gradients_have_the_same_bits_on_every_instruction_set() {
    for options in [OPTIONS, PER_PIXEL] {
        let mut isas = Isa::to_test();
        let portable = large(&mut Rasterizer::on(isas.next().unwrap()), &options, 1);
        assert!(norm(&lists_of(&portable)) > 1.0);
        for isa in isas {
            assert!(large(&mut Rasterizer::on(isa), &options, 1) == portable, "{isa:?} differs");
        }
    }
}

#[test]
fn gradients_have_the_same_bits_for_any_number_of_threads() {
    for options in [OPTIONS, PER_PIXEL] {
        let found = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| large(&mut Rasterizer::new(), &options, 1))
        });
        assert!(found[0] == found[1] && found[1] == found[2]);
    }
}

#[test]
fn earlier_gradients_leave_no_trace() {
    let expected = large(&mut Rasterizer::new(), &OPTIONS, 1);
    let expected_per_pixel = large(&mut Rasterizer::new(), &PER_PIXEL, 1);
    let mut rasterizer = Rasterizer::new();
    large(&mut rasterizer, &PER_PIXEL, 2);
    assert!(large(&mut rasterizer, &PER_PIXEL, 1) == expected_per_pixel);
    let few = random(3, 50, 1);
    let pixels = camera().size().pixels();
    let antialiased = Gaussians { antialiased: true, ..few.clone() };
    fast(&mut rasterizer, &antialiased, &camera(), None, &OPTIONS, &gradients(pixels, 1));
    let mut frame = Frame::new();
    let mut out = expected.clone();
    let mut rendering = rasterizer.render(&few, &camera(), None, &OPTIONS, &mut frame).unwrap();
    rendering.backward(&gradients(pixels, 1), &mut out).unwrap();
    rendering.backward(&gradients(pixels, 2), &mut out).unwrap();
    assert!(out == fast(&mut Rasterizer::new(), &few, &camera(), None, &OPTIONS, &gradients(pixels, 2)));
    assert!(large(&mut rasterizer, &OPTIONS, 1) == expected);
}

#[test]
fn a_moved_position_that_is_not_finite_has_no_gradient_and_harms_no_other() {
    let gaussians = random(7, 60, 0);
    let all = gradients(camera().size().pixels(), 2);
    for bad in [f32::NAN, f32::INFINITY] {
        let mut next = jittered(&gaussians, 7, 0.02);
        next.positions.iter_mut().step_by(3).for_each(|position| position.x = bad);
        let next = Next { gaussians: &next, camera: &second() };
        let found = assert_agree(&gaussians, &camera(), Some(next), &OPTIONS, &all);
        assert!(lists_of(&found).iter().all(|value| value.is_finite()));
        assert!(found.next_positions.iter().step_by(3).all(|gradient| *gradient == Vec3::ZERO));
        assert!(found.next_positions.iter().any(|gradient| *gradient != Vec3::ZERO));
    }
}

#[test]
fn lists_that_do_not_fit_the_image_are_refused() {
    let gaussians = random(1, 2, 0);
    let mut rasterizer = Rasterizer::new();
    let mut rendering = rasterizer.render(&gaussians, &camera(), None, &OPTIONS, &mut Frame::new()).unwrap();
    let long = FrameGradients { color: vec![[0.0; 3]; 83 * 57 + 1], ..FrameGradients::default() };
    let error = rendering.backward(&long, &mut GaussianGradients::default()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the gradients: color has 4732 entries, an image of 83x57 (WIDTHxHEIGHT) needs 4731 or none"
    );
}

#[test]
fn extreme_but_finite_parameters_give_no_nan() {
    let extremes = [0.0, -0.0, 1e-45, -1e-20, 1e10, -1e15];
    let pixels = camera().size().pixels();
    for a in extremes {
        for b in extremes {
            let mut gaussians = random(2, 20, 0);
            push_each(&mut gaussians, a, b);
            let mut next = gaussians.clone();
            next.positions.reverse();
            let next = Next { gaussians: &next, camera: &camera() };
            let gradients = gradients(pixels, 1);
            for (antialiased, options) in [(false, OPTIONS), (true, OPTIONS), (false, PER_PIXEL)] {
                gaussians.antialiased = antialiased;
                let found =
                    fast(&mut Rasterizer::new(), &gaussians, &camera(), Some(next), &options, &gradients);
                let values = lists_of(&found);
                assert!(values.iter().all(|value| !value.is_nan()), "{a} {b}");
            }
        }
    }
}
