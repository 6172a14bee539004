//! Features of clips.

use srflow_core::{FlowField, Plane, Size};
use srflow_mer::{
    Channel, FEATURE_SIDE, FeatureError, FeatureSettings, Features, HeadMotion, StrainFormula,
    features_of_flow,
};

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
    assert_eq!(error, FeatureError::Size { channel: Channel::V, size: Size::new(112, 111) });
    let mut broken = plane.clone();
    broken.set(7, 3, f32::NAN);
    let error = Features::new(&plane, &plane, &broken).unwrap_err();
    assert_eq!(error, FeatureError::NotFinite { channel: Channel::Strain, x: 7, y: 3 });
    assert_eq!(Features::from_values(vec![0.0; 5]), Err(FeatureError::Length { found: 5 }));
}

/// A face whose right half moves in a swirl, with nothing at its border.
fn swirl(angle: f32) -> FlowField {
    let (sin, cos) = angle.sin_cos();
    let centre = (FEATURE_SIDE - 1) as f32 / 2.0;
    FlowField::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| {
        let (right, down) = (x as f32 - centre, y as f32 - centre);
        let (right, down) = (cos * right + sin * down, cos * down - sin * right);
        let size = (-((right - 20.0).powi(2) + down.powi(2)) / 200.0).exp();
        let (u, v) = (2.0 * size - 0.05 * down * size, 0.05 * right * size);
        [cos * u - sin * v, sin * u + cos * v]
    })
}

fn features_of(flow: FlowField) -> Features {
    let settings = FeatureSettings {
        head_motion: HeadMotion::Keep,
        strain: StrainFormula::Literature,
        ..Default::default()
    };
    features_of_flow(flow, settings).unwrap().0
}

#[test]
fn a_mirrored_clip_has_the_features_of_its_mirrored_flow() {
    let flow = swirl(0.3);
    let mirrored = FlowField::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| {
        let [u, v] = flow.get(FEATURE_SIDE - 1 - x, y);
        [-u, v]
    });
    let features = features_of(flow);
    let (found, expected) = (features.mirrored(), features_of(mirrored));
    let difference =
        found.values().iter().zip(expected.values()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(difference < 1e-6, "{difference}");
    assert_eq!(found.mirrored(), features);
}

#[test]
fn a_rotated_clip_has_the_features_of_its_rotated_flow() {
    let angle = 8.0_f32;
    let found = features_of(swirl(0.0)).rotated(angle);
    let expected = features_of(swirl(angle.to_radians()));
    for channel in [Channel::U, Channel::V, Channel::Strain] {
        let pairs = || found.channel(channel).iter().zip(expected.channel(channel));
        let difference = pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let largest = pairs().map(|(_, b)| b.abs()).fold(0.0, f32::max);
        assert!(difference < 0.05 * largest, "{channel:?}: {difference} of {largest}");
    }
}
