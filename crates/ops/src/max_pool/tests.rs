use burn::tensor::{Device, Tensor, TensorData};

use super::*;
use crate::test_values::values;

const SIZES: [MapSize; 4] = [
    MapSize { planes: 3, height: 8, width: 36 },
    MapSize { planes: 2, height: 7, width: 5 },
    MapSize { planes: 2, height: 1, width: 6 },
    MapSize { planes: 0, height: 4, width: 4 },
];

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

/// What Burn has, which other devices take.
#[test]
fn tensors_and_their_gradients_are_burns() {
    let (shape, device) = ([2, 3, 7, 10], Device::flex().autodiff());
    let numbers = values(shape.iter().product(), 3);
    let grads = values(2 * 3 * 3 * 5, 4);
    let run = |pool: &dyn Fn(Tensor<4>) -> Tensor<4>| -> [Vec<f32>; 2] {
        let x = Tensor::<4>::from_data(TensorData::new(numbers.clone(), shape), &device).require_grad();
        let out = pool(x.clone());
        let weights = Tensor::from_data(TensorData::new(grads.clone(), [2, 3, 3, 5]), &device);
        let gradients = (out.clone() * weights).sum().backward();
        [out.inner(), x.grad(&gradients).unwrap()].map(|tensor| tensor.into_data().try_to_vec().unwrap())
    };
    let options = burn::tensor::ops::MaxPoolOptions::new([2, 2]);
    let expected = run(&|x| burn::tensor::module::max_pool2d(x, options.clone()));
    assert_eq!(run(&tensor::max_pool), expected);
}
