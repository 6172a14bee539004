use super::tensor::{Reset, Update};
use super::{GruSize, reference, reset, update};
use crate::operation::tests::Case;
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

pub(crate) fn cases() -> Vec<Case> {
    let size = GruSize { batch: 2, channels: 3, pixels: 20 };
    let (gates, hidden): (&[usize], &[usize]) = (&[2, 6, 4, 5], &[2, 3, 4, 5]);
    let narrow = |x: Vec<f64>| x.into_iter().map(|x| x as f32).collect();
    let of_reset = move |x: &[Vec<f32>]| narrow(reference::reset(&wide(&x[0]), &wide(&x[1]), size));
    let of_update =
        move |x: &[Vec<f32>]| narrow(reference::update(&wide(&x[0]), &wide(&x[1]), &wide(&x[2]), size));
    vec![
        Case::of("reset", Reset, [gates, hidden], of_reset),
        Case::of("update", Update, [gates, hidden, hidden], of_update),
    ]
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
