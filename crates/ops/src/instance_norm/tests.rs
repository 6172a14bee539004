use burn::backend::Flex;

use super::*;
use crate::flex::{Contiguous, tensor};
use crate::test_values::values;

/// Planes whose mean is far larger than their spread.
fn input(planes: usize, pixels: usize) -> Vec<f32> {
    values(planes * pixels, 1).iter().enumerate().map(|(i, x)| 30.0 * (i / pixels) as f32 + x * 0.5).collect()
}

#[test]
fn the_fast_version_is_the_definition() {
    for pixels in [3, 16, 1999] {
        let input = input(5, pixels);
        for activation in [Activation::Identity, Activation::Relu] {
            let expected = reference::instance_norm(&input, pixels, activation);
            let found = instance_norm(&input, pixels, activation);
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-4, "{pixels}: {found} for {expected}");
            }
        }
    }
}

#[test]
fn the_version_of_other_devices_is_the_fast_one() {
    let shape = [2, 3, 5, 7];
    let (input, grad) = (values(210, 1), values(210, 2));
    let check = |found: &_, expected: Vec<f32>| {
        for (found, expected) in Contiguous::new(found).slice().iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found} for {expected}");
        }
    };
    let out = composed::normalized::<Flex>(tensor(input.clone(), shape), Activation::Relu);
    check(&out, instance_norm(&input, 35, Activation::Relu));
    let d_input = composed::gradient::<Flex>(tensor(input.clone(), shape), tensor(grad.clone(), shape));
    check(&d_input, instance_norm_backward(&input, &grad, 35));
}

/// Central differences of the definition.
#[test]
fn the_gradient_is_that_of_the_definition() {
    const STEP: f32 = 1.0 / 256.0;
    let pixels = 37;
    let input = values(3 * pixels, 1);
    let grad = values(input.len(), 2);
    let found = instance_norm_backward(&input, &grad, pixels);
    let value = |input: &[f32]| {
        let out = reference::instance_norm(input, pixels, Activation::Identity);
        out.iter().zip(&grad).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
    };
    for i in 0..input.len() {
        let moved = |by: f32| {
            let mut input = input.clone();
            input[i] += by;
            value(&input)
        };
        let expected = (moved(STEP) - moved(-STEP)) / f64::from(2.0 * STEP);
        assert!((f64::from(found[i]) - expected).abs() < 1e-3, "[{i}]: {} for {expected}", found[i]);
    }
}
