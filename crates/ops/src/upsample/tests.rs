use burn::backend::Flex;

use super::*;
use crate::flex::{Contiguous, tensor};
use crate::test_values::values;

const SHAPES: [UpsampleShape; 2] = [
    UpsampleShape { batch: 2, coarse: [3, 5], factor: 4 },
    UpsampleShape { batch: 1, coarse: [1, 2], factor: 8 },
];

#[test]
fn the_fast_version_is_the_definition() {
    for shape in SHAPES {
        let (flow, mask) = (values(shape.flow_len(), 1), values(shape.mask_len(), 2));
        let expected = reference::convex_upsample(&flow, &mask, 5.0, &shape);
        let found = convex_upsample(&flow, &mask, 5.0, &shape);
        assert!(expected.iter().any(|x| x.abs() > 1.0));
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-5, "{found} for {expected}");
        }
    }
}

#[test]
fn the_version_of_other_devices_is_the_fast_one() {
    for shape in SHAPES {
        let (flow, mask) = (values(shape.flow_len(), 1), values(shape.mask_len(), 2));
        let grad = values(shape.output_len(), 3);
        let UpsampleShape { batch, coarse: [height, width], factor } = shape;
        let inputs = || {
            let mask = tensor(mask.clone(), [batch, NEIGHBOURS * factor * factor, height, width]);
            (tensor(flow.clone(), [batch, 2, height, width]), mask)
        };
        let check = |found: &_, expected: Vec<f32>| {
            for (found, expected) in Contiguous::new(found).slice().iter().zip(expected) {
                assert!((found - expected).abs() < 1e-5, "{found} for {expected}");
            }
        };
        let (flow_tensor, mask_tensor) = inputs();
        let out = composed::upsampled::<Flex>(flow_tensor, mask_tensor, 5.0, &shape);
        check(&out, convex_upsample(&flow, &mask, 5.0, &shape));
        let (flow_tensor, mask_tensor) = inputs();
        let grad_tensor = tensor(grad.clone(), [batch, 2, height * factor, width * factor]);
        let (d_flow, d_mask) =
            composed::gradients::<Flex>(flow_tensor, mask_tensor, 0.25, grad_tensor, &shape);
        let (expected_flow, expected_mask) = convex_upsample_backward(&flow, &mask, 0.25, &grad, &shape);
        check(&d_flow, expected_flow);
        check(&d_mask, expected_mask);
    }
}

#[test]
fn constant_flow_stays_constant_inside() {
    let shape = UpsampleShape { batch: 1, coarse: [4, 4], factor: 8 };
    let flow = [vec![1.5; 16], vec![-0.25; 16]].concat();
    let out = convex_upsample(&flow, &values(shape.mask_len(), 3), 1.0, &shape);
    for y in 8..24 {
        for x in 8..24 {
            assert!((out[y * 32 + x] - 12.0).abs() < 1e-5);
            assert!((out[1024 + y * 32 + x] + 2.0).abs() < 1e-5);
        }
    }
}

/// Central differences of the definition.
#[test]
fn the_gradients_are_those_of_the_definition() {
    const STEP: f32 = 1.0 / 64.0;
    for shape in SHAPES {
        let (flow, mask) = (values(shape.flow_len(), 1), values(shape.mask_len(), 2));
        let grad = values(shape.output_len(), 3);
        let (d_flow, d_mask) = convex_upsample_backward(&flow, &mask, 0.25, &grad, &shape);
        let value = |flow: &[f32], mask: &[f32]| {
            let out = reference::convex_upsample(flow, mask, 0.25, &shape);
            out.iter().zip(&grad).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
        };
        let check = |found: f32, difference: f64| {
            let expected = difference / f64::from(2.0 * STEP);
            assert!((f64::from(found) - expected).abs() < 1e-3, "{found} for {expected}");
        };
        for i in 0..flow.len() {
            let moved = |by: f32| {
                let mut flow = flow.clone();
                flow[i] += by;
                value(&flow, &mask)
            };
            check(d_flow[i], moved(STEP) - moved(-STEP));
        }
        for i in (0..mask.len()).step_by(13) {
            let moved = |by: f32| {
                let mut mask = mask.clone();
                mask[i] += by;
                value(&flow, &mask)
            };
            check(d_mask[i], moved(STEP) - moved(-STEP));
        }
    }
}
