use super::tensor::MaxPool;
use super::*;
use crate::operation::tests::Case;
use crate::test_values::values;

const SIZES: [MapSize; 4] = [
    MapSize { planes: 3, height: 8, width: 36 },
    MapSize { planes: 2, height: 7, width: 5 },
    MapSize { planes: 2, height: 1, width: 6 },
    MapSize { planes: 0, height: 4, width: 4 },
];

/// Values so far apart that few maxima change hands nearby.
pub(crate) fn cases() -> Vec<Case> {
    let size = MapSize { planes: 6, height: 7, width: 10 };
    let definition = move |x: &[Vec<f32>]| reference::max_pool(&x[0], size);
    vec![Case::of("max pool", MaxPool, [&[2, 3, 7, 10]], definition).change(0, |_, x| 10.0 * x)]
}

/// Few different values, so that many are equal, and some that are no numbers.
fn input(size: MapSize, numbers: bool) -> Vec<f32> {
    let coarse = |x: f32| (x * 2.0).round();
    let value = |x: f32| if !numbers && coarse(x) == 2.0 { f32::NAN } else { coarse(x) };
    values(size.planes * size.pixels(), 1).into_iter().map(value).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

#[test]
fn the_fast_version_is_the_definition_to_the_bit() {
    for (size, numbers) in SIZES.into_iter().flat_map(|size| [(size, true), (size, false)]) {
        let input = input(size, numbers);
        assert_eq!(bits(&max_pool(&input, size)), bits(&reference::max_pool(&input, size)), "{size:?}");
        let grad = values(size.planes * size.pooled_pixels(), 2);
        let expected = reference::max_pool_backward(&input, &grad, size);
        assert_eq!(max_pool_backward(&input, &grad, size), expected, "{size:?}");
    }
}
