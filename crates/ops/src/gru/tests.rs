use super::reference;
use super::{GruSize, reset, reset_backward, update, update_backward};
use crate::test_values::{assert_close, values};

const SIZES: [GruSize; 4] = [
    GruSize { batch: 1, channels: 1, pixels: 1 },
    GruSize { batch: 2, channels: 3, pixels: 35 },
    GruSize { batch: 2, channels: 16, pixels: 1500 },
    GruSize { batch: 0, channels: 3, pixels: 4 },
];

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

/// Within 1e-6: nothing here is larger than 3.
fn assert_near(what: &str, found: &[f32], expected: &[f64]) {
    let expected: Vec<f32> = expected.iter().map(|&x| x as f32).collect();
    assert_close(what, found, &expected, 3e-7);
}

#[test]
fn steps_are_those_of_the_definition() {
    for size in SIZES {
        let len = size.hidden_len();
        let (gates, hidden, candidate) = (values(2 * len, 1), values(len, 2), values(len, 3));
        let (gates64, hidden64, candidate64) = (wide(&gates), wide(&hidden), wide(&candidate));
        assert_near("reset", &reset(&gates, &hidden, size), &reference::reset(&gates64, &hidden64, size));
        let expected = reference::update(&gates64, &hidden64, &candidate64, size);
        assert_near("update", &update(&gates, &hidden, &candidate, size), &expected);
    }
}

/// Central differences of the definition, which are exact: it is linear in each of its inputs.
#[test]
fn gradients_are_those_of_the_definition() {
    for size in &SIZES[..2] {
        let size = *size;
        let len = size.hidden_len();
        let inputs = [values(2 * len, 4), values(len, 5), values(len, 6)];
        let grad = values(len, 7);
        let slopes = |number: usize, of: &dyn Fn(&[Vec<f64>; 3]) -> Vec<f64>| -> Vec<f64> {
            (0..inputs[number].len())
                .map(|i| {
                    let at = |step: f64| {
                        let mut moved = inputs.each_ref().map(|input| wide(input));
                        moved[number][i] += step;
                        of(&moved).iter().zip(&grad).map(|(x, g)| x * f64::from(*g)).sum::<f64>()
                    };
                    (at(0.5) - at(-0.5)) / 1.0
                })
                .collect()
        };
        let [gates, hidden, candidate] = inputs.each_ref();
        let of_reset = |x: &[Vec<f64>; 3]| reference::reset(&x[0], &x[1], size);
        for (number, found) in reset_backward(gates, hidden, &grad, size).iter().enumerate() {
            assert_near("gradient of reset", found, &slopes(number, &of_reset));
        }
        let of_update = |x: &[Vec<f64>; 3]| reference::update(&x[0], &x[1], &x[2], size);
        for (number, found) in update_backward(gates, hidden, candidate, &grad, size).iter().enumerate() {
            assert_near("gradient of update", found, &slopes(number, &of_update));
        }
    }
}
