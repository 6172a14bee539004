//! Features of clips.

use srflow_core::Plane;
use srflow_mer::{Channel, FEATURE_SIDE, FeatureError, Features};

#[test]
fn maps_lie_one_after_the_other() {
    let plane =
        |value| Plane::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| value + (y * FEATURE_SIDE + x) as f32);
    let features = Features::new(&plane(0.5), &plane(0.25), &plane(0.0)).unwrap();
    assert_eq!(features.values().len(), Features::LEN);
    assert_eq!(features.channel(Channel::V)[..2], [0.25, 1.25]);
    assert_eq!(features.values()[2 * 112 * 112 + 112], 112.0);
}

#[test]
fn other_sizes_and_values_that_are_not_finite_are_refused() {
    let plane = Plane::new(FEATURE_SIDE, FEATURE_SIDE);
    let error = Features::new(&plane, &Plane::new(112, 111), &plane).unwrap_err();
    assert_eq!(error, FeatureError::Size { channel: Channel::V, size: (112, 111) });
    let mut broken = plane.clone();
    broken.set(7, 3, f32::NAN);
    let error = Features::new(&plane, &plane, &broken).unwrap_err();
    assert_eq!(error, FeatureError::NotFinite { channel: Channel::Strain, x: 7, y: 3 });
    assert_eq!(Features::from_values(vec![0.0; 5]), Err(FeatureError::Length { found: 5 }));
}
