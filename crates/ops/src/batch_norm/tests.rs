use burn::backend::Flex;

use super::*;
use crate::flex::{Contiguous, tensor};
use crate::test_values::values;

const SHAPE: BatchNormShape = BatchNormShape { batch: 4, channels: 3, pixels: 37 };

/// Channels whose mean is far larger than their spread.
fn input() -> Vec<f32> {
    let channel = |i: usize| i / SHAPE.pixels % SHAPE.channels;
    let values = values(SHAPE.batch * SHAPE.channels * SHAPE.pixels, 1);
    values.iter().enumerate().map(|(i, x)| 20.0 * channel(i) as f32 + x * 0.5).collect()
}

fn affine(relu: bool) -> Affine<'static> {
    Affine { weight: &[1.0, -0.5, 2.0], bias: &[0.25, 0.0, -1.0], relu }
}

#[test]
fn the_fast_version_is_the_definition() {
    for relu in [false, true] {
        let (found, statistics) = batch_norm(&input(), &affine(relu), &SHAPE);
        let expected = reference::batch_norm(&input(), &affine(relu), &SHAPE);
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-4, "{found} for {expected}");
        }
        assert_eq!(found.contains(&0.0), relu);
        assert!(statistics.mean.windows(2).all(|pair| (pair[1] - pair[0] - 20.0).abs() < 0.5));
    }
}

#[test]
fn the_version_of_other_devices_is_the_fast_one() {
    let input = values(SHAPE.batch * SHAPE.channels * SHAPE.pixels, 1);
    let grad = values(input.len(), 2);
    let map = |values: &[f32]| tensor(values.to_vec(), [SHAPE.batch, SHAPE.channels, 1, SHAPE.pixels]);
    let per_channel = |values: &[f32]| tensor(values.to_vec(), [SHAPE.channels]);
    let check = |found: &_, expected: &[f32]| {
        for (found, expected) in Contiguous::new(found).slice().iter().zip(expected) {
            assert!((found - expected).abs() < 2e-5 * expected.abs().max(1.0), "{found} for {expected}");
        }
    };
    for relu in [false, true] {
        let affine = affine(relu);
        let (weight, bias) = (per_channel(affine.weight), per_channel(affine.bias));
        let (out, mean, variance) =
            composed::normalized::<Flex>(map(&input), weight.clone(), bias.clone(), relu);
        let (expected, statistics) = batch_norm(&input, &affine, &SHAPE);
        check(&out, &expected);
        check(&mean, &statistics.mean);
        check(&variance, &statistics.variance);
        let saved = [map(&input), weight, bias, mean, variance];
        let [d_input, d_weight, d_bias] = composed::gradients::<Flex>(saved, relu, map(&grad));
        let expected = batch_norm_backward(&input, &grad, &affine, &statistics, &SHAPE);
        check(&d_input, &expected.input);
        check(&d_weight, &expected.weight);
        check(&d_bias, &expected.bias);
    }
}

/// Central differences of the definition.
#[test]
fn the_gradients_are_those_of_the_definition() {
    const STEP: f32 = 1.0 / 256.0;
    let input = values(SHAPE.batch * SHAPE.channels * SHAPE.pixels, 1);
    let grad = values(input.len(), 2);
    let Affine { weight, bias, .. } = affine(false);
    let value = |input: &[f32], weight: &[f32], bias: &[f32]| {
        let out = reference::batch_norm(input, &Affine { weight, bias, relu: false }, &SHAPE);
        out.iter().zip(&grad).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()
    };
    let (_, statistics) = batch_norm(&input, &affine(false), &SHAPE);
    let found = batch_norm_backward(&input, &grad, &affine(false), &statistics, &SHAPE);
    let compare = |name: &str, found: &[f32], at: &[f32], of: &dyn Fn(&[f32]) -> f64| {
        for i in 0..found.len() {
            let moved = |by: f32| {
                let mut at = at.to_vec();
                at[i] += by;
                of(&at)
            };
            let expected = (moved(STEP) - moved(-STEP)) / f64::from(2.0 * STEP);
            let error = (f64::from(found[i]) - expected).abs();
            assert!(error < 2e-3, "{name}[{i}]: {} for {expected}", found[i]);
        }
    };
    compare("input", &found.input, &input, &|input| value(input, weight, bias));
    compare("weight", &found.weight, weight, &|weight| value(&input, weight, bias));
    compare("bias", &found.bias, bias, &|bias| value(&input, weight, bias));
}

#[test]
fn the_relu_lets_through_the_gradient_of_what_is_positive() {
    let input = input();
    let grad = values(input.len(), 2);
    let (out, statistics) = batch_norm(&input, &affine(true), &SHAPE);
    let let_through: Vec<f32> =
        grad.iter().zip(&out).map(|(&grad, &y)| if y > 0.0 { grad } else { 0.0 }).collect();
    let expected = batch_norm_backward(&input, &let_through, &affine(false), &statistics, &SHAPE);
    assert_eq!(batch_norm_backward(&input, &grad, &affine(true), &statistics, &SHAPE), expected);
}

#[test]
fn a_channel_with_what_is_not_a_number_becomes_that() {
    for relu in [false, true] {
        let mut input = input();
        input[SHAPE.pixels] = f32::NAN;
        let (found, _) = batch_norm(&input, &affine(relu), &SHAPE);
        let expected = reference::batch_norm(&input, &affine(relu), &SHAPE);
        for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let second_channel = i / SHAPE.pixels % SHAPE.channels == 1;
            assert_eq!([found.is_nan(), expected.is_nan()], [second_channel; 2], "element {i}, relu {relu}");
        }
    }
}
