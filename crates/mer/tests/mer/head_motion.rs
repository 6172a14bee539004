//! The head's motion, taken out of the flow.

use srflow_core::{FlowField, Plane};
use srflow_mer::HeadMotion;

#[test]
fn what_is_subtracted_is_reported_in_pixels_of_the_features() {
    // Turned by half a degree and moved, in frames of twice the features' size.
    let angle = 0.5_f32.to_radians();
    let flow = FlowField::from_fn(224, 224, |x, y| {
        let (x, y) = (x as f32 - 111.5, y as f32 - 111.5);
        [3.0 - angle * y, angle * x - 1.0]
    });
    let (rest, motion) = HeadMotion::Subtract.applied(flow.clone());
    assert!(rest.pixels().iter().flatten().all(|component| component.abs() < 1e-3));
    let motion = motion.unwrap();
    let [x, y] = motion.translation_px;
    assert!((x - 1.5).abs() < 1e-3 && (y + 0.5).abs() < 1e-3, "{motion:?}");
    assert!((motion.rotation_degrees - 0.5).abs() < 1e-3 && (motion.scale - 1.0).abs() < 1e-5, "{motion:?}");
    assert_eq!(HeadMotion::Keep.applied(flow.clone()), (flow, None));
}

#[test]
fn the_background_is_neither_followed_nor_left() {
    // A head that moves before a wall that does not, with a smile.
    let inside = |x: usize, y: usize| (20..92).contains(&x) && y > 10;
    let smile = |x: usize, y: usize| (50..62).contains(&x) && (75..85).contains(&y);
    let flow = FlowField::from_fn(112, 112, |x, y| match (inside(x, y), smile(x, y)) {
        (false, _) => [0.0, 0.0],
        (true, false) => [0.8, -0.3],
        (true, true) => [0.8, -0.7],
    });
    let (rest, motion) = HeadMotion::Subtract.applied(flow);
    assert!((motion.unwrap().translation_px[0] - 0.8).abs() < 1e-3);
    let v = Plane::from_fn(112, 112, |x, y| rest.get(x, y)[1]);
    assert!((v.get(5, 60) - 0.3).abs() < 1e-3, "the wall moves with respect to the head");
    let v = HeadMotion::Subtract.within_face(v);
    assert!(v.get(5, 60) == 0.0 && v.get(30, 40).abs() < 1e-3 && (v.get(56, 80) + 0.4).abs() < 1e-3);
}
