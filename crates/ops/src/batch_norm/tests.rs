use burn::backend::Flex;

use super::tensor::BatchNorm;
use super::*;
use crate::flex::CpuTensor;
use crate::operation::tests::Case;
use crate::operation::{Composition, array};
use crate::test_values::{assert_close, values, wide};

pub(crate) fn cases() -> Vec<Case> {
    let case = |relu, offset: f32| {
        let (pixels, channels) = (SHAPE.pixels(), SHAPE.channels);
        Case::of(
            &format!("batch norm, relu {relu}"),
            BatchNorm { relu },
            [&SHAPE.dims(), &[channels], &[channels]],
            move |x| reference::batch_norm([&x[0], &x[1], &x[2]], relu, &SHAPE),
            move |x, grad| reference::batch_norm_backward([&x[0], &x[1], &x[2]], grad, relu, &SHAPE).into(),
        )
        .change(0, move |i, x| offset * (i / pixels % channels) as f32 + x)
    };
    // The last with channels whose mean is far larger than their spread.
    vec![case(false, 0.0), case(true, 0.0), case(true, 8.0)]
}

#[test]
fn the_statistics_of_other_devices_are_those_of_the_kernel() {
    let (input, affine) = (input(), affine(false));
    let (_, expected) = batch_norm(&input, &affine, &SHAPE);
    let [weight, bias] = [affine.weight, affine.bias].map(|x| CpuTensor::new(x.to_vec(), [SHAPE.channels]));
    let input = CpuTensor::new(input, SHAPE.dims());
    let inputs = [input, weight, bias].map(CpuTensor::into);
    let outputs = BatchNorm { relu: false }.composed::<Flex>(inputs);
    let [_, mean, variance] = array(outputs.into_iter().map(CpuTensor::from).collect());
    assert_close("mean", mean.slice(), &wide(&expected.mean), 1e-6);
    assert_close("variance", variance.slice(), &wide(&expected.variance), 1e-5);
    assert!(expected.mean.windows(2).all(|pair| (pair[1] - pair[0] - 20.0).abs() < 0.5));
}

const SHAPE: MapShape = MapShape { batch: 4, channels: 3, height: 5, width: 7 };

/// Channels whose mean is far larger than their spread.
fn input() -> Vec<f32> {
    let channel = |i: usize| i / SHAPE.pixels() % SHAPE.channels;
    let values = values(SHAPE.elements(), 1);
    values.iter().enumerate().map(|(i, x)| 20.0 * channel(i) as f32 + x * 0.5).collect()
}

fn affine(relu: bool) -> Affine<'static> {
    Affine { weight: &[1.0, -0.5, 2.0], bias: &[0.25, 0.0, -1.0], relu }
}

#[test]
fn a_channel_with_what_is_not_a_number_becomes_that() {
    for relu in [false, true] {
        let mut input = input();
        input[SHAPE.pixels()] = f32::NAN;
        let (found, _) = batch_norm(&input, &affine(relu), &SHAPE);
        let Affine { weight, bias, .. } = affine(relu);
        let expected = reference::batch_norm([&wide(&input), &wide(weight), &wide(bias)], relu, &SHAPE);
        for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
            let second_channel = i / SHAPE.pixels() % SHAPE.channels == 1;
            assert_eq!([found.is_nan(), expected.is_nan()], [second_channel; 2], "element {i}, relu {relu}");
        }
    }
}
