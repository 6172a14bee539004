use std::ops::Range;

use burn::tensor::Tensor;
use srflow_simd::{Isa, Precision};

use super::lookup::{Paired, lookup_with};
use super::pyramid::{channels_first, channels_last};
use super::reference::LookupShape;
use super::*;
use crate::operation::array;
use crate::operation::tests::Case;
use crate::test_values::{assert_close, values, wide};

/// Positions inside, across every border, far outside, and on whole pixels.
fn positions([batch, _, height, width]: [usize; 4]) -> Vec<f32> {
    let position = |(i, x): (usize, f32)| match i % 11 {
        0 => x.round(),
        1 => x * 1e9,
        _ => (x * 0.7 + 0.5) * width as f32,
    };
    values(batch * 2 * height * width, 3).into_iter().enumerate().map(position).collect()
}

#[test]
fn each_instruction_set_computes_the_definition() {
    for (maps, levels, radius) in [([2, 19, 11, 14], 4, 4), ([1, 32, 9, 9], 3, 3), ([1, 5, 3, 2], 4, 1)] {
        let (shape, [batch, channels, height, width]) = (LookupShape { maps, levels, radius }, maps);
        let [first, second] = [1, 2].map(|seed| values(maps.iter().product(), seed));
        let (coords, grad) = (positions(maps), values(shape.output_len(), 4));
        let [wide_first, wide_second, wide_coords, wide_grad] =
            [&first, &second, &coords, &grad].map(|values| wide(values));
        let expected = reference::correlation_lookup(&wide_first, &wide_second, &wide_coords, &shape);
        let pyramid = FeaturePyramid::new(&second, maps, levels);
        let first = channels_last(&first, batch, channels);
        let lookup = |isa, precision| {
            let kept = Paired::default();
            lookup_with(isa, precision, &first, &pyramid, &kept, &coords, [height, width], radius)
        };
        for isa in Isa::to_test() {
            let found = lookup(isa, Precision::F32);
            assert_close(&format!("{isa:?}, {shape:?}"), &found, &expected, 1e-5);
            // Errors of features of bfloat16, and few of them to average.
            let found = lookup(isa, Precision::Bf16);
            assert_close(&format!("bfloat16, {isa:?}, {shape:?}"), &found, &expected, 4e-3);
        }
        let [d_first, d_second] = reference::correlation_lookup_backward(
            &wide_first,
            &wide_second,
            &wide_coords,
            &wide_grad,
            &shape,
        );
        let (found, d_levels) =
            correlation_lookup_backward(&first, &pyramid, &coords, [height, width], radius, &grad);
        let found = channels_first(&found, batch, channels);
        assert_close(&format!("gradient of the first map, {shape:?}"), &found, &d_first, 1e-5);
        let found = pyramid.backward(d_levels);
        assert_close(&format!("gradient of the second map, {shape:?}"), &found, &d_second, 1e-5);
    }
}

/// The whole way from feature maps to windows. Numbers of channels that vectors divide and that they do not; the last with as
/// many channels, levels and entries as RAFT has.
pub(crate) fn cases() -> Vec<Case> {
    let case = |maps @ [batch, _, height, width]: [usize; 4], levels, radius| {
        let (shape, coords) = (LookupShape { maps, levels, radius }, positions(maps));
        Case::new(
            &format!("{shape:?}"),
            &[&maps, &maps, &[batch, 2, height, width]],
            move |inputs| {
                let [first, second, coords] = array(inputs.into_iter().map(Tensor::from_dispatch).collect());
                tensor::Correlation::new(first, second, levels).windows(coords, radius)
            },
            move |x| reference::correlation_lookup(&x[0], &x[1], &x[2], &shape),
            move |x, grad| reference::correlation_lookup_backward(&x[0], &x[1], &x[2], grad, &shape).into(),
        )
        .change(2, move |i, _| coords[i])
    };
    vec![case([2, 4, 6, 7], 3, 2), case([2, 3, 6, 7], 2, 4), case([2, 256, 9, 13], 4, 4), some_rows()]
}

/// Windows of some rows of the first map: those rows of all windows.
fn some_rows() -> Case {
    const ROWS: Range<usize> = 2..5;
    let maps @ [batch, _, height, width] = [2, 4, 7, 6];
    let shape = LookupShape { maps, levels: 3, radius: 2 };
    let part = ROWS.start * width..ROWS.end * width;
    let with_others = {
        let part = part.clone();
        move |rows: &[f64]| {
            let whole = rows.chunks_exact(part.len()).flat_map(|rows| {
                let mut plane = vec![0.0; height * width];
                plane[part.clone()].copy_from_slice(rows);
                plane
            });
            whole.collect::<Vec<_>>()
        }
    };
    let rows_of = move |planes: &[f64]| -> Vec<f64> {
        planes.chunks_exact(height * width).flat_map(|plane| plane[part.clone()].to_vec()).collect()
    };
    let own = rows_of(&wide(&positions(maps)));
    let whole = with_others.clone();
    Case::new(
        "of some rows",
        &[&maps, &maps, &[batch, 2, ROWS.len(), width]],
        move |inputs| {
            let [first, second, coords] = array(inputs.into_iter().map(Tensor::from_dispatch).collect());
            tensor::Correlation::new(first, second, 3).of_rows(ROWS).windows(coords, 2)
        },
        move |x| rows_of(&reference::correlation_lookup(&x[0], &x[1], &whole(&x[2]), &shape)),
        move |x, grad| {
            let (coords, grad) = (with_others(&x[2]), with_others(grad));
            reference::correlation_lookup_backward(&x[0], &x[1], &coords, &grad, &shape).into()
        },
    )
    .change(2, move |i, _| own[i] as f32)
}
