//! What [`Sorting::PerPixel`] is for.

use glam::{DMat3, DVec3, Quat, Vec3};

use super::scenes::{camera, push};
use crate::{Camera, Frame, Gaussians, Options, Rasterizer, Sorting};

/// Two long Gaussians, red and blue, that cross each other like the strokes of an X, seen from above at an angle.
fn crossing() -> Gaussians {
    let mut gaussians = Gaussians::default();
    for (turn, color) in [(0.5, [1.0, 0.0, 0.0]), (-0.5, [0.0, 0.0, 1.0])] {
        push(&mut gaussians, Vec3::ZERO, Vec3::new(0.3, 0.1, 0.03), Quat::from_rotation_y(turn), 0.9, color);
    }
    gaussians.positions[0].z += 0.002;
    gaussians.positions[1].x += 0.01;
    gaussians
}

/// The frame of a camera that has turned by `angle` around the crossing.
fn render(gaussians: &Gaussians, angle: f64, sorting: Sorting) -> Frame {
    let turn = DMat3::from_rotation_y(angle);
    let camera = camera().placed(turn, turn * DVec3::new(0.0, 0.0, -1.0));
    let mut frame = Frame::new();
    let options = Options { sorting, ..Options::default() };
    Rasterizer::new().render(gaussians, &camera, None, &options, &mut frame).unwrap();
    frame
}

/// The mean change of the picture in each of `steps` steps of a turn.
fn changes(steps: usize, sorting: Sorting) -> Vec<f64> {
    let gaussians = crossing();
    let frames: Vec<Frame> =
        (0..=steps).map(|step| render(&gaussians, 0.6 * step as f64 / steps as f64 - 0.3, sorting)).collect();
    let change = |a: &Frame, b: &Frame| {
        let pairs = a.color.as_flattened().iter().zip(b.color.as_flattened());
        pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / a.alpha.pixels().len() as f64
    };
    frames.windows(2).map(|pair| change(&pair[0], &pair[1])).collect()
}

/// As the camera turns in smaller and smaller steps, so changes the picture; with one order for all pixels, a jump remains.
#[test]
fn a_turning_camera_changes_the_picture_little_by_little() {
    let largest = |changes: Vec<f64>| changes.into_iter().fold(0.0, f64::max);
    let [coarse, fine] = [50, 400].map(|steps| largest(changes(steps, Sorting::PerPixel)));
    assert!(fine < 0.25 * coarse, "{fine} of {coarse} in steps of an eighth");
    let [coarse_global, fine_global] = [50, 400].map(|steps| largest(changes(steps, Sorting::Global)));
    assert!(fine_global > 0.7 * coarse_global, "{fine_global} of {coarse_global} in steps of an eighth");
    assert!(fine < 0.05 * fine_global, "the largest change is {fine}, with one order {fine_global}");
}

/// The red one is in front on the one side of the crossing, the blue one on the other.
#[test]
fn gaussians_that_cross_hide_each_other_on_opposite_sides() {
    let frame = render(&crossing(), 0.0, Sorting::PerPixel);
    let at = |x: usize| frame.color[31 * frame.width + x];
    let (left, right) = (at(37 - 10), at(37 + 10));
    assert!(left[0] > 2.0 * left[2] || left[2] > 2.0 * left[0], "{left:?}");
    assert!((left[0] > left[2]) == (right[2] > right[0]), "{left:?} {right:?}");
    // One order for all pixels shows one of them in front on both sides.
    let frame = render(&crossing(), 0.0, Sorting::Global);
    let at = |x: usize| frame.color[31 * frame.width + x];
    assert_eq!(at(37 - 10)[0] > at(37 - 10)[2], at(37 + 10)[0] > at(37 + 10)[2]);
}

/// Gaussians at distances that all rays agree on.
#[test]
fn gaussians_in_layers_look_the_same_in_both_orders() {
    let mut gaussians = Gaussians::default();
    for i in 0..60 {
        let place = Vec3::new(
            0.05 * (i % 7) as f32 - 0.15,
            0.04 * (i % 5) as f32 - 0.1,
            1.0 + 0.05 * ((i * 37) % 60) as f32,
        );
        push(
            &mut gaussians,
            place,
            Vec3::new(0.08, 0.05, 0.004),
            Quat::IDENTITY,
            0.7,
            [0.3 * (i % 3) as f32, 0.5, 0.2],
        );
    }
    let render = |sorting| {
        let mut frame = Frame::new();
        let options = Options { sorting, ..Options::default() };
        Rasterizer::new().render(&gaussians, &Camera { ..camera() }, None, &options, &mut frame).unwrap();
        frame
    };
    let (global, per_pixel) = (render(Sorting::Global), render(Sorting::PerPixel));
    assert_eq!(global.statistics, per_pixel.statistics);
    for (a, b) in global.color.as_flattened().iter().zip(per_pixel.color.as_flattened()) {
        assert!((a - b).abs() < 1e-5, "{a} {b}");
    }
}
