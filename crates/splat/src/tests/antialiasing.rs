//! What [`Gaussians::antialiased`] is for.

use glam::{Quat, Vec3};
use srflow_core::Size;

use super::scenes::{camera, push, single};
use crate::{Camera, Frame, Gaussians, Options, Rasterizer};

fn render(gaussians: &Gaussians, camera: &Camera, antialiased: bool) -> Frame {
    let mut frame = Frame::new();
    let gaussians = Gaussians { antialiased, ..gaussians.clone() };
    Rasterizer::new().render(&gaussians, camera, None, &Options::default(), &mut frame).unwrap();
    frame
}

fn total_alpha(frame: &Frame) -> f64 {
    frame.alpha.pixels().iter().copied().map(f64::from).sum()
}

/// From a third of a pixel on, what a shrinking Gaussian covers is its own area; otherwise it stays that of the filter. Needles
/// count by their width.
#[test]
fn a_gaussian_smaller_than_a_pixel_covers_in_proportion_to_its_area() {
    let pixels = |size: f32| size / 90.0; // at a depth of 1
    for (x, y) in [(0.0, 0.0), (0.004, 0.003), (-0.007, 0.001)] {
        for sigma in [0.35, 0.25, 0.18] {
            let ball = single(Vec3::new(x, y, 1.0), pixels(sigma), 0.9);
            let camera = Camera { fy: 90.0, ..camera() };
            let own = std::f64::consts::TAU * f64::from(sigma * sigma) * 0.9;
            let (with, without) = (render(&ball, &camera, true), render(&ball, &camera, false));
            let (with, without) = (total_alpha(&with) / own, total_alpha(&without) / own);
            // A little is lost where alpha is under 1/255.
            assert!((0.9..1.01).contains(&with), "{sigma} px: {with} of its area");
            assert!(without > 3.0, "{sigma} px: {without} of its area without");

            let mut needle = Gaussians::default();
            let scale = Vec3::new(pixels(5.0), pixels(sigma), pixels(sigma));
            push(&mut needle, Vec3::new(x, y, 1.0), scale, Quat::from_rotation_z(0.4), 0.9, [1.0; 3]);
            let own = std::f64::consts::TAU * 5.0 * f64::from(sigma) * 0.9;
            let (with, without) = (render(&needle, &camera, true), render(&needle, &camera, false));
            let (with, without) = (total_alpha(&with) / own, total_alpha(&without) / own);
            assert!((0.93..1.01).contains(&with), "{sigma} px: {with} of the needle's area");
            assert!(without > 1.5, "{sigma} px: {without} of the needle's area without");
        }
    }
}

/// Thin strands in front of a background: the small picture is the large one, averaged.
#[test]
fn a_smaller_picture_is_the_average_of_a_larger_one() {
    let large = Camera::centred(Size::new(240, 240), [900.0; 2]);
    let small = large.resized(Size::new(30, 30));
    let mut strands = Gaussians::default();
    for i in 0..24 {
        let place = Vec3::new(0.01 * i as f32 - 0.115, 0.004 * (i % 5) as f32, 1.0 + 0.01 * i as f32);
        push(&mut strands, place, Vec3::new(0.0012, 0.05, 0.0012), Quat::from_rotation_z(0.1), 0.8, [1.0; 3]);
    }
    let expected = render(&strands, &large, true);
    let error = |antialiased: bool| {
        let found = render(&strands, &small, antialiased);
        let mut total = 0.0;
        for y in 0..30 {
            for x in 0..30 {
                let block = (0..64).map(|i| f64::from(expected.alpha.get(8 * x + i % 8, 8 * y + i / 8)));
                total += (f64::from(found.alpha.get(x, y)) - block.sum::<f64>() / 64.0).abs();
            }
        }
        total / 900.0
    };
    assert!(error(true) < 0.25 * error(false), "{} with, {} without", error(true), error(false));
}

/// A disc seen exactly from its edge has no area.
#[test]
fn a_gaussian_without_area_is_not_drawn() {
    let mut disc = single(Vec3::new(0.0, 0.0, 1.0), 0.1, 1.0);
    disc.scales[0] = Vec3::new(0.1, 0.0, 0.1);
    let camera = Camera { cy: 30.0, ..camera() };
    assert!(total_alpha(&render(&disc, &camera, false)) > 10.0);
    assert_eq!(render(&disc, &camera, true).statistics.visible, 0);
}
