use super::*;
use crate::test_values::values;

const SHAPE: WarpShape = WarpShape { batch: 2, channels: 3, size: [5, 7] };

/// Inside, across every border, far outside.
fn flow() -> Vec<f32> {
    let mut flow = values(SHAPE.flow_len(), 2);
    for (i, x) in flow.iter_mut().enumerate() {
        *x *= if i % 9 == 0 { 1e9 } else { 4.0 };
    }
    flow
}

#[test]
fn the_fast_version_is_the_definition() {
    let image = values(SHAPE.image_len(), 1);
    let expected = reference::warp(&image, &flow(), &SHAPE);
    let found = warp(&image, &flow(), &SHAPE);
    assert!(expected.iter().any(|x| x.abs() > 0.2));
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() < 1e-5, "{found} for {expected}");
    }
}

#[test]
fn no_flow_changes_nothing_and_a_flow_of_nan_harms_nothing_else() {
    let image = values(SHAPE.image_len(), 1);
    let mut flow = vec![0.0; SHAPE.flow_len()];
    assert_eq!(warp(&image, &flow, &SHAPE), image);
    flow[0] = f32::NAN;
    assert_eq!(warp(&image, &flow, &SHAPE)[1..35], image[1..35]);
}

/// Central differences of the definition; bilinear sampling is linear between whole pixels, which no sample comes near.
#[test]
fn the_gradients_are_those_of_the_definition() {
    const STEP: f32 = 1.0 / 512.0;
    let image = values(SHAPE.image_len(), 1);
    let flow: Vec<f32> = values(SHAPE.flow_len(), 2)
        .iter()
        .map(|x| {
            let x = 4.0 * x;
            let fraction = x - x.floor();
            x.floor() + fraction.clamp(0.05, 0.95)
        })
        .collect();
    let grad = values(SHAPE.image_len(), 3);
    let (d_image, d_flow) = warp_backward(&image, &flow, &grad, &SHAPE);
    let value = |image: &[f32], flow: &[f32]| {
        let out = reference::warp(image, flow, &SHAPE);
        out.iter().zip(&grad).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
    };
    let check = |found: f32, moved: &dyn Fn(f32) -> f64| {
        let expected = (moved(STEP) - moved(-STEP)) / f64::from(2.0 * STEP);
        assert!((f64::from(found) - expected).abs() < 1e-3, "{found} for {expected}");
    };
    let shifted = |values: &[f32], i: usize, by: f32| {
        let mut values = values.to_vec();
        values[i] += by;
        values
    };
    for i in 0..image.len() {
        check(d_image[i], &|by| value(&shifted(&image, i, by), &flow));
    }
    for i in 0..flow.len() {
        check(d_flow[i], &|by| value(&image, &shifted(&flow, i, by)));
    }
}
