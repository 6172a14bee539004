use burn::tensor::Tensor;
use srflow_simd::Isa;

use super::lookup::lookup_with;
use super::pyramid::{channels_first, channels_last};
use super::*;
use crate::operation::array;
use crate::operation::tests::Case;
use crate::test_values::values;

struct Sample {
    size: [usize; 4],
    levels: usize,
    radius: usize,
    first: Vec<f32>,
    second: Vec<f32>,
    coords: Vec<f32>,
}

/// Features of odd sizes, with positions inside, across every border, far outside, and on whole pixels.
fn sample(size: [usize; 4], levels: usize, radius: usize) -> Sample {
    let [batch, channels, height, width] = size;
    let count = batch * channels * height * width;
    let mut coords = values(batch * 2 * height * width, 3);
    for (i, x) in coords.iter_mut().enumerate() {
        *x = match i % 11 {
            0 => x.round(),
            1 => *x * 1e9,
            _ => (*x * 0.7 + 0.5) * width as f32,
        };
    }
    Sample { size, levels, radius, first: values(count, 1), second: values(count, 2), coords }
}

fn samples() -> [Sample; 3] {
    [sample([2, 19, 11, 14], 4, 4), sample([1, 32, 9, 9], 3, 3), sample([1, 5, 3, 2], 4, 1)]
}

#[test]
fn the_lookup_is_that_of_the_all_pairs_volume() {
    for case in samples() {
        let [_, _, height, width] = case.size;
        let expected = reference::correlation_lookup(
            &case.first,
            &case.second,
            &case.coords,
            case.size,
            case.levels,
            case.radius,
        );
        assert!(expected.iter().any(|x| x.abs() > 0.1));
        let pyramid = FeaturePyramid::new(&case.second, case.size, case.levels);
        let first = channels_last(&case.first, case.size[0], case.size[1]);
        for isa in Isa::to_test() {
            let found = lookup_with(isa, &first, &pyramid, &case.coords, [height, width], case.radius);
            assert_eq!(found.len(), expected.len());
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert!(
                    (found - expected).abs() < 2e-5,
                    "{isa:?} {:?} [{i}]: {found} for {expected}",
                    case.size
                );
            }
        }
    }
}

/// The lookup is linear in each feature map, so a finite difference is exact but for rounding; computed in f64 by the
/// definition.
#[test]
fn the_gradients_are_those_of_the_definition() {
    let case = sample([2, 3, 5, 6], 2, 2);
    let [_, _, height, width] = case.size;
    let pyramid = FeaturePyramid::new(&case.second, case.size, case.levels);
    let lookup = |first: &[f32], second: &[f32]| {
        reference::correlation_lookup(first, second, &case.coords, case.size, case.levels, case.radius)
    };
    let grad = values(lookup(&case.first, &case.second).len(), 4);
    let first = channels_last(&case.first, case.size[0], case.size[1]);
    let (d_first, d_levels) =
        correlation_lookup_backward(&first, &pyramid, &case.coords, [height, width], case.radius, &grad);
    let d_first = channels_first(&d_first, case.size[0], case.size[1]);
    let d_second = pyramid.backward(d_levels);
    let along = |out: &[f32]| out.iter().zip(&grad).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    for i in (0..case.first.len()).step_by(7) {
        let mut unit = vec![0.0; case.first.len()];
        unit[i] = 1.0;
        let expected = [along(&lookup(&unit, &case.second)), along(&lookup(&case.first, &unit))];
        for (found, expected) in [d_first[i], d_second[i]].into_iter().zip(expected) {
            assert!((f64::from(found) - expected).abs() < 1e-4, "[{i}]: {found} for {expected}");
        }
    }
}

#[test]
fn gradients_do_not_depend_on_threads() {
    let case = sample([1, 8, 20, 17], 3, 3);
    let pyramid = FeaturePyramid::new(&case.second, case.size, case.levels);
    let grad = values(3 * 49 * 20 * 17, 5);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| correlation_lookup_backward(&case.first, &pyramid, &case.coords, [20, 17], 3, &grad))
    };
    assert!(run(1) == run(3));
}

/// The whole way from feature maps to windows. Numbers of channels that vectors divide and that they do not; the last with as
/// many channels, levels and entries as RAFT has.
pub(crate) fn cases() -> Vec<Case> {
    let case = |size @ [batch, channels, height, width]: [usize; 4], levels, radius| {
        let map: &[usize] = &[batch, channels, height, width];
        let coords = sample(size, levels, radius).coords;
        Case::new(
            &format!("lookup, {size:?}, {levels} levels, radius {radius}"),
            &[map, map, &[batch, 2, height, width]],
            move |inputs| {
                let [first, second, coords] = array(inputs.into_iter().map(Tensor::from_dispatch).collect());
                tensor::Correlation::new(first, second, levels).windows(coords, radius)
            },
            move |x| reference::correlation_lookup(&x[0], &x[1], &x[2], size, levels, radius),
        )
        .change(2, move |i, _| coords[i])
        .constant(2)
    };
    vec![case([2, 4, 6, 7], 3, 2), case([2, 3, 6, 7], 2, 4), case([2, 256, 9, 13], 4, 4).slopes(0)]
}
