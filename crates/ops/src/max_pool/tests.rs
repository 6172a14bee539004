use super::tensor::MaxPool;
use super::*;
use crate::operation::tests::Case;
use crate::test_values::{values, wide};

const SIZES: [[usize; 4]; 4] = [[1, 3, 8, 36], [2, 1, 7, 5], [1, 2, 1, 6], [0, 1, 4, 4]];

pub(crate) fn cases() -> Vec<Case> {
    let size = MapShape::from([2, 3, 7, 11]);
    vec![Case::of(
        "max pool",
        MaxPool,
        [&[2, 3, 7, 11]],
        move |x| reference::max_pool(&x[0], size),
        move |x, grad| vec![reference::max_pool_backward(&x[0], grad, size)],
    )]
}

/// Few different values, so that many are equal, and some that are no numbers.
fn input(size: MapShape, numbers: bool) -> Vec<f32> {
    let coarse = |x: f32| (x * 2.0).round();
    let value = |x: f32| if !numbers && coarse(x) == 2.0 { f32::NAN } else { coarse(x) };
    values(size.elements(), 1).into_iter().map(value).collect()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

#[test]
fn the_fast_version_is_the_definition_to_the_bit() {
    for (size, numbers) in
        SIZES.into_iter().map(MapShape::from).flat_map(|size| [(size, true), (size, false)])
    {
        let input = input(size, numbers);
        let expected = reference::max_pool(&wide(&input), size);
        assert_eq!(bits(&wide(&max_pool(&input, size))), bits(&expected), "{size:?}");
        let grad = values(pooled(size).elements(), 2);
        let expected = reference::max_pool_backward(&wide(&input), &wide(&grad), size);
        assert_eq!(wide(&max_pool_backward(&input, &grad, size)), expected, "{size:?}");
    }
}
