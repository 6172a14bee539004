//! Flow of motion with a closed form.

use glam::{DVec2, DVec3, Quat, Vec3};
use srflow_core::Size;

use super::scenes::{camera, jittered, moved, push, random, single};
use crate::{Camera, Frame, Gaussians, Next, Options, PixelConvention, RasterizeError, Rasterizer};

fn render(gaussians: &Gaussians, camera: &Camera, next: Next<'_>, convention: PixelConvention) -> Frame {
    let mut frame = Frame::new();
    let options = Options { convention, ..Options::default() };
    Rasterizer::new().render(gaussians, camera, Some(next), &options, &mut frame).unwrap();
    frame
}

/// Flow is `displacement * alpha` at every pixel, and the normalised flow is `displacement` wherever anything is visible.
#[track_caller]
fn assert_displacement(frame: &Frame, displacement: DVec2) {
    let normalized = frame.flow_normalized();
    let mut seen = 0;
    for (i, (&alpha, flow)) in frame.alpha.pixels().iter().zip(frame.flow.pixels()).enumerate() {
        let expected = displacement * f64::from(alpha);
        let flow = DVec2::new(f64::from(flow[0]), f64::from(flow[1]));
        assert!(
            (flow - expected).length() <= 1e-6 * displacement.length(),
            "pixel {i}: {flow}, not {expected}"
        );
        if alpha > 0.0 {
            let [u, v] = normalized.pixels()[i].map(f64::from);
            let error = (DVec2::new(u, v) - displacement).length();
            assert!(
                error <= 3e-5 * displacement.length(),
                "pixel {i}: normalised ({u}, {v}), not {displacement}"
            );
            seen += 1;
        }
    }
    assert!(seen > 100, "only {seen} pixels see it");
}

#[test]
fn a_translating_gaussian_moves_by_its_projected_displacement() {
    let camera = camera();
    let (from, to) = (Vec3::new(0.03, -0.02, 1.1), Vec3::new(0.08, 0.01, 1.3));
    let gaussians = single(from, 0.08, 0.7);
    let frame = render(
        &gaussians,
        &camera,
        Next { gaussians: &single(to, 0.08, 0.7), camera: &camera },
        PixelConvention::Splat,
    );
    let expected = camera.project(to.as_dvec3()).unwrap().0 - camera.project(from.as_dvec3()).unwrap().0;
    assert_displacement(&frame, expected);
    for (alpha, (depth, depth_next)) in
        frame.alpha.pixels().iter().zip(frame.depth.pixels().iter().zip(frame.depth_next.pixels()))
    {
        let seen = f32::from(u8::from(*alpha > 0.0));
        assert!((depth - 1.1 * seen).abs() < 1e-4 && (depth_next - 1.3 * seen).abs() < 1e-4);
    }
}

#[test]
fn a_moving_camera_alone_makes_flow() {
    let first = camera();
    let second = Camera { fx: 95.0, cx: 40.0, ..moved(first, 0.04, 0.02, DVec3::new(0.02, -0.03, 0.05)) };
    let position = Vec3::new(-0.1, 0.05, 1.4);
    let gaussians = single(position, 0.1, 0.9);
    let frame =
        render(&gaussians, &first, Next { gaussians: &gaussians, camera: &second }, PixelConvention::Splat);
    let at = position.as_dvec3();
    assert_displacement(&frame, second.project(at).unwrap().0 - first.project(at).unwrap().0);
}

#[test]
fn nothing_moves_without_motion() {
    let gaussians = random(5, 200, 1);
    let camera = camera();
    let frame =
        render(&gaussians, &camera, Next { gaussians: &gaussians, camera: &camera }, PixelConvention::Splat);
    assert!(frame.flow.pixels().iter().all(|flow| *flow == [0.0; 2]));
    assert_eq!(frame.depth, frame.depth_next);
}

#[test]
fn the_papers_convention_shrinks_displacements() {
    let first = camera();
    let second = moved(first, 0.05, 0.01, DVec3::ZERO);
    let gaussians = random(9, 200, 0);
    let moved = jittered(&gaussians, 2, 0.01);
    let next = Next { gaussians: &moved, camera: &second };
    let splat = render(&gaussians, &first, next, PixelConvention::Splat);
    let paper = render(&gaussians, &first, next, PixelConvention::Paper);
    assert_eq!(splat.color, paper.color);
    let (sx, sy) = (82.0 / 83.0, 56.0 / 57.0);
    for (a, b) in splat.flow.pixels().iter().zip(paper.flow.pixels()) {
        assert!((a[0] * sx - b[0]).abs() <= 1e-5 * (1.0 + a[0].abs()), "{a:?} {b:?}");
        assert!((a[1] * sy - b[1]).abs() <= 1e-5 * (1.0 + a[1].abs()), "{a:?} {b:?}");
    }
}

#[test]
fn a_gaussian_that_passes_behind_the_next_camera_has_no_displacement() {
    let camera = camera();
    let mut gaussians = single(Vec3::new(0.0, 0.0, 0.5), 0.1, 0.5);
    push(&mut gaussians, Vec3::new(0.0, 0.0, 2.0), Vec3::splat(0.3), Quat::IDENTITY, 0.9, [0.5; 3]);
    let nearer = moved(camera, 0.0, 0.0, DVec3::new(0.1, 0.0, -0.6));
    let frame =
        render(&gaussians, &camera, Next { gaussians: &gaussians, camera: &nearer }, PixelConvention::Splat);
    assert_eq!(frame.statistics.without_displacement, 1);
    let seen_alone = {
        let mut frame = Frame::new();
        Rasterizer::new().render(&gaussians, &camera, None, &Options::default(), &mut frame).unwrap();
        frame
    };
    assert_eq!(seen_alone.color, frame.color);
    assert_eq!(seen_alone.flow.size(), Size::new(0, 0));
    // At the centre the far one is visible through the near one: half of its displacement of 0.1 / 1.4 * 90 px.
    let [u, v] = frame.flow.get(37, 31);
    assert!((u - 0.5 * 0.9 * (0.1 / 1.4 * 90.0)).abs() < 0.1 && v.abs() < 0.1, "({u}, {v})");
}

#[test]
fn sets_that_do_not_correspond_are_refused() {
    let camera = camera();
    let (two, three) = (random(1, 2, 0), random(1, 3, 0));
    let mut frame = Frame::new();
    let mut error = |gaussians: &Gaussians, camera: &Camera, next: Next<'_>| {
        Rasterizer::new().render(gaussians, camera, Some(next), &Options::default(), &mut frame).unwrap_err()
    };
    assert_eq!(
        error(&two, &camera, Next { gaussians: &three, camera: &camera }),
        RasterizeError::CountMismatch { first: 2, next: 3 }
    );
    let wider = Camera { width: 84, ..camera };
    assert_eq!(
        error(&two, &camera, Next { gaussians: &two, camera: &wider }),
        RasterizeError::SizeMismatch { first: Size::new(83, 57), next: Size::new(84, 57) }
    );
    let mut ragged = three.clone();
    ragged.opacities.pop();
    let message = error(&ragged, &camera, Next { gaussians: &three, camera: &camera }).to_string();
    assert_eq!(message, "the Gaussians: opacities has 2 entries, 3 Gaussians need 3");
}
