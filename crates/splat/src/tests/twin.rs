//! The fast rasterizer against the reference.

use glam::{DVec3, Quat, Vec3};

use super::scenes::{camera, jittered, moved, push, push_each, random, single, test_device};
use crate::reference::{self, Pixel};
use crate::{Camera, Device, DeviceRasterizer, Frame, Gaussians, Next, Options, Sorting, Statistics};

const BACKGROUND: [f32; 3] = [0.1, 0.5, 0.9];

/// The rendering of each device, that of the CPU first, and of the twin; without `next` nothing moves.
fn both(gaussians: &Gaussians, camera: &Camera, next: Option<Next<'_>>) -> (Vec<Frame>, Vec<Pixel>) {
    both_with(&Options::default(), gaussians, camera, next)
}

fn both_with(
    options: &Options,
    gaussians: &Gaussians,
    camera: &Camera,
    next: Option<Next<'_>>,
) -> (Vec<Frame>, Vec<Pixel>) {
    let next = next.or(Some(Next { gaussians, camera }));
    let options = Options { background: BACKGROUND, ..*options };
    let mut devices = vec![Device::cpu()];
    if options.sorting == Sorting::Global {
        devices.extend(test_device());
    }
    let frames = devices.iter().map(|device| {
        let mut frame = Frame::new();
        DeviceRasterizer::new(device).render(gaussians, camera, next, &options, &mut frame).unwrap();
        frame
    });
    (frames.collect(), reference::render(gaussians, camera, next, &options).unwrap())
}

/// Compares each frame with the twin: colour within 2/255 everywhere, flow within 0.01 px and depths within 1e-3 wherever alpha is over one
/// half. Returns the number of pixels with such alpha.
#[track_caller]
fn assert_close(frames: &[Frame], pixels: &[Pixel]) -> usize {
    for frame in frames {
        assert_one_close(frame, pixels);
    }
    pixels.iter().filter(|pixel| pixel.alpha > 0.5).count()
}

#[track_caller]
fn assert_one_close(frame: &Frame, pixels: &[Pixel]) {
    assert_eq!((frame.width * frame.height, frame.color.len()), (pixels.len(), pixels.len()));
    for (i, pixel) in pixels.iter().enumerate() {
        let (x, y) = (i % frame.width, i / frame.width);
        for channel in 0..3 {
            let (fast, slow) = (frame.color[i][channel], pixel.color[channel]);
            let byte = frame.image.pixels()[i][channel];
            assert!(
                (f64::from(fast) - slow).abs() < 2.0 / 255.0,
                "colour at ({x}, {y}): {fast}, twin {slow}"
            );
            assert!((f64::from(byte) - slow.clamp(0.0, 1.0) * 255.0).abs() < 2.5, "byte at ({x}, {y})");
        }
        let alpha = frame.alpha.pixels()[i];
        assert!(
            (f64::from(alpha) - pixel.alpha).abs() < 1.0 / 255.0,
            "alpha at ({x}, {y}): {alpha}, twin {}",
            pixel.alpha
        );
        if pixel.alpha <= 0.5 {
            continue;
        }
        let depths =
            [(frame.depth.pixels()[i], pixel.depth), (frame.depth_next.pixels()[i], pixel.depth_next)];
        for (fast, slow) in depths {
            assert!((f64::from(fast) - slow).abs() < 1e-3, "depth at ({x}, {y}): {fast}, twin {slow}");
        }
        for (fast, slow) in frame.flow.pixels()[i].iter().zip(pixel.flow) {
            assert!((f64::from(*fast) - slow).abs() < 0.01, "flow at ({x}, {y}): {fast}, twin {slow}");
        }
    }
}

#[test]
fn random_scenes_agree() {
    let first = camera();
    let second = moved(first, 0.05, -0.03, DVec3::new(0.05, 0.02, -0.1));
    let mut covered = 0;
    for seed in 0..48 {
        let count = [3, 30, 120, 400][seed as usize % 4];
        let mut gaussians = random(seed, count, seed as usize / 4 % 4);
        gaussians.antialiased = seed / 16 == 1;
        let next = jittered(&gaussians, seed, 0.02);
        let next = Next { gaussians: &next, camera: &second };
        let sorting = if seed >= 32 { Sorting::PerPixel } else { Sorting::Global };
        let options = Options { sorting, ..Options::default() };
        let (frames, pixels) = both_with(&options, &gaussians, &first, Some(next));
        covered += assert_close(&frames, &pixels);
        let twin: u64 = pixels.iter().map(|pixel| u64::from(pixel.blended)).sum();
        for Statistics { visible, blended, without_displacement } in
            frames.iter().map(|frame| frame.statistics)
        {
            assert!(blended.abs_diff(twin) * 10_000 <= twin, "{blended} pairs blended, twin {twin}");
            let Statistics { visible: expected, without_displacement: still, .. } = frames[0].statistics;
            assert_eq!((visible, without_displacement), (expected, still));
        }
    }
    assert!(covered > 60_000, "only {covered} pixels were covered");
}

#[test]
fn empty_scene_is_background() {
    let gaussians = Gaussians::default();
    let camera = camera();
    let (frames, pixels) = both(&gaussians, &camera, Some(Next { gaussians: &gaussians, camera: &camera }));
    assert_eq!(assert_close(&frames, &pixels), 0);
    for frame in frames {
        assert!(frame.color.iter().all(|color| *color == BACKGROUND));
        assert!(frame.image.pixels().iter().all(|pixel| *pixel == [26, 128, 230]));
        assert!(frame.depth.pixels().iter().chain(frame.alpha.pixels()).all(|value| *value == 0.0));
        assert!(frame.flow.pixels().iter().all(|flow| *flow == [0.0; 2]));
    }
}

#[test]
fn gaussians_behind_the_near_plane_are_not_drawn() {
    for depth in [-3.0, -0.2, 0.0, 0.1, 0.199_999] {
        let (frames, pixels) = both(&single(Vec3::new(0.0, 0.0, depth), 5.0, 1.0), &camera(), None);
        assert_close(&frames, &pixels);
        assert!(frames.iter().all(|frame| frame.statistics.visible == 0), "depth {depth}");
    }
}

#[test]
fn needles_agree_at_every_angle() {
    let camera = Camera { width: 640, height: 480, fx: 700.0, fy: 700.0, cx: 320.0, cy: 240.0, ..camera() };
    for step in 0..12 {
        let angle = step as f32 * 0.27 + 0.01;
        let mut gaussians = Gaussians::default();
        let rotation = Quat::from_rotation_z(angle);
        push(
            &mut gaussians,
            Vec3::new(0.02, 0.01, 1.5),
            Vec3::new(2.0, 1e-5, 1e-5),
            rotation,
            0.95,
            [0.9; 3],
        );
        let (frames, pixels) = both(&gaussians, &camera, None);
        assert!(assert_close(&frames, &pixels) > 300, "angle {angle}");
    }
}

#[test]
fn huge_gaussians_and_those_across_the_border_agree() {
    let mut gaussians = Gaussians::default();
    for (i, x) in [-0.45, 0.0, 0.47, 0.9, 3.0].into_iter().enumerate() {
        let size = [0.05, 0.3, 0.05, 0.4, 2.5][i];
        push(
            &mut gaussians,
            Vec3::new(x, -0.35, 1.0),
            Vec3::splat(size),
            Quat::IDENTITY,
            0.6,
            [0.2, 0.6, 0.4],
        );
    }
    push(&mut gaussians, Vec3::new(0.0, 0.0, 50.0), Vec3::splat(1e6), Quat::IDENTITY, 0.9, [0.7; 3]);
    push(&mut gaussians, Vec3::new(1e7, 0.0, 5.0), Vec3::splat(1e7), Quat::IDENTITY, 0.9, [0.3; 3]);
    let (frames, pixels) = both(&gaussians, &camera(), None);
    assert_eq!(assert_close(&frames, &pixels), pixels.len());
}

#[test]
fn equal_depths_are_drawn_in_order_of_index() {
    let mut gaussians = Gaussians::default();
    for i in 0..40 {
        let color = if i == 0 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
        push(&mut gaussians, Vec3::new(0.0, 0.0, 1.0), Vec3::splat(0.2), Quat::IDENTITY, 0.9, color);
    }
    let (frames, pixels) = both(&gaussians, &camera(), None);
    assert_close(&frames, &pixels);
    for frame in frames {
        let center = frame.color[31 * frame.width + 37];
        assert!(center[0] > 0.85 && center[2] < 0.15, "the first is in front: {center:?}");
    }
}

#[test]
fn a_pixel_is_done_before_its_transmittance_falls_under_the_limit() {
    let mut gaussians = Gaussians::default();
    for i in 0..6 {
        push(
            &mut gaussians,
            Vec3::new(0.0, 0.0, 1.0 + i as f32),
            Vec3::splat(9.0),
            Quat::IDENTITY,
            1.0,
            [0.5; 3],
        );
    }
    let (frames, pixels) = both(&gaussians, &camera(), None);
    assert_close(&frames, &pixels);
    // The first leaves a transmittance of 0.01 (alpha is clamped to 0.99), the second would leave less than 1e-4.
    assert!(pixels.iter().all(|pixel| pixel.blended == 1));
    assert!(frames.iter().all(|frame| frame.statistics.blended == pixels.len() as u64));
}

#[test]
fn parameters_that_are_not_finite_hide_a_gaussian_and_nothing_else() {
    let good = single(Vec3::new(0.0, 0.0, 1.0), 0.1, 0.8);
    let (expected, _) = both(&good, &camera(), Some(Next { gaussians: &good, camera: &camera() }));
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for parameter in 0..14 {
            let mut gaussians = single(Vec3::new(0.1, 0.0, 0.9), 0.1, 0.8);
            gaussians.sh_degree = 0;
            match parameter {
                0..3 => gaussians.positions[0][parameter] = bad,
                3..6 => gaussians.scales[0][parameter - 3] = bad,
                6 => gaussians.opacities[0] = bad,
                7..10 => gaussians.sh[0][parameter - 7] = bad,
                _ => {
                    let mut xyzw = gaussians.rotations[0].to_array();
                    xyzw[parameter - 10] = bad;
                    gaussians.rotations[0] = Quat::from_array(xyzw);
                }
            }
            push(
                &mut gaussians,
                Vec3::new(0.0, 0.0, 1.0),
                Vec3::splat(0.1),
                Quat::IDENTITY,
                0.8,
                [1.0, 0.2, 0.1],
            );
            let next = Next { gaussians: &gaussians, camera: &camera() };
            let (frames, pixels) = both(&gaussians, &camera(), Some(next));
            assert_close(&frames, &pixels);
            assert_eq!(frames, expected, "parameter {parameter} = {bad}");
        }
    }
}

#[test]
fn extreme_but_finite_parameters_do_no_harm() {
    let extremes = [0.0, -0.0, 1e-45, -1e-20, 1e20, -1e30, f32::MAX, f32::MIN];
    for a in extremes {
        for b in extremes {
            let mut gaussians = single(Vec3::new(0.0, 0.0, 1.0), 0.1, 0.5);
            push_each(&mut gaussians, a, b);
            let mut next = gaussians.clone();
            next.positions.reverse();
            for (antialiased, sorting) in
                [(false, Sorting::Global), (true, Sorting::Global), (false, Sorting::PerPixel)]
            {
                gaussians.antialiased = antialiased;
                let options = Options { sorting, ..Options::default() };
                let next = Next { gaussians: &next, camera: &camera() };
                for frame in both_with(&options, &gaussians, &camera(), Some(next)).0 {
                    assert!(frame.alpha.pixels().iter().all(|alpha| (0.0..=1.0).contains(alpha)), "{a} {b}");
                    assert!(frame.flow.pixels().iter().flatten().all(|value| !value.is_nan()), "{a} {b}");
                }
            }
        }
    }
}
