use burn::tensor::Tensor;
use srflow_simd::{Precision, panel_columns};

use super::*;
use crate::operation::{array, tests::Case};
use crate::test_values::{assert_close, assert_within, largest, values, wide, with_threads};

const CHANNELS: usize = 9;
const VALUE_CHANNELS: usize = 5;

/// Queries, keys (of scores up to a few tens, so that some weights vanish) and values of `pixels`.
fn image(pixels: usize) -> [Vec<f32>; 3] {
    let scaled = |seed: u32| values(CHANNELS * pixels, seed).into_iter().map(|x| 4.0 * x).collect();
    [scaled(1), scaled(2), values(VALUE_CHANNELS * pixels, 3)]
}

#[test]
fn each_instruction_set_computes_the_definition_whatever_is_kept() {
    for pixels in [1, 30, 131, 450] {
        let [queries, keys, values] = image(pixels);
        let expected = reference::attention(&wide(&queries), &wide(&keys), &wide(&values), pixels);
        let log_sums = reference::log_sums(&wide(&queries), &wide(&keys), pixels);
        for isa in Isa::to_test() {
            for kept_bytes in [0, 4 * panel_columns(isa) * 4 * pixels, usize::MAX] {
                let weights =
                    AttentionWeights::new(isa, Precision::F32, [&queries, &keys], pixels, kept_bytes);
                let what = format!("{pixels} pixels, {isa:?}, {kept_bytes} bytes allowed");
                assert_close(&what, &weights.gather(&values), &expected, 5e-6);
                assert_close(&what, &weights.log_sums(), &log_sums, 5e-6);
            }
        }
    }
}

/// Gradients of what is gathered twice, of other values the second time, and of the logarithms of the sums.
#[test]
fn each_instruction_set_computes_the_gradients_of_the_definition_whatever_is_kept() {
    for pixels in [1, 30, 131, 450] {
        let [queries, keys, first] = image(pixels);
        let of = |seed: u32| values(VALUE_CHANNELS * pixels, seed);
        let gatherings = [(first, of(4)), (of(5), of(6))];
        let [wide_queries, wide_keys] = [&queries, &keys].map(|values| wide(values));
        let expected = gatherings.each_ref().map(|(values, grad)| {
            reference::attention_backward(&wide_queries, &wide_keys, &wide(values), &wide(grad), pixels)
        });
        let of_log_sums = values(pixels, 7);
        let by_log_sums =
            reference::log_sums_backward(&wide_queries, &wide_keys, &wide(&of_log_sums), pixels);
        let sum = |of: usize| -> Vec<f64> {
            let all = expected[0][of].iter().zip(&expected[1][of]).zip(&by_log_sums[of]);
            all.map(|((a, b), c)| a + b + c).collect()
        };
        for isa in Isa::to_test() {
            for kept_bytes in [0, 4 * panel_columns(isa) * 4 * pixels, usize::MAX] {
                let what = format!("{pixels} pixels, {isa:?}, {kept_bytes} bytes allowed");
                let weights =
                    AttentionWeights::new(isa, Precision::F32, [&queries, &keys], pixels, kept_bytes);
                let outs = gatherings.each_ref().map(|(values, _)| weights.gather(values));
                let gathered: Vec<Gathered> = gatherings
                    .iter()
                    .zip(&outs)
                    .map(|((values, grad), gathered)| Gathered { values, gathered, grad })
                    .collect();
                let [d_queries, d_keys] = weights.backward(&queries, &keys, &gathered, &of_log_sums);
                let alone = weights.backward(&queries, &keys, &[], &of_log_sums);
                for (found, expected) in alone.iter().zip(&by_log_sums) {
                    assert_close(&format!("by the sums alone, {what}"), found, expected, 1e-5);
                }
                // The weight of a single pixel is always one: then there is no gradient but what rounding leaves.
                for (found, of) in [(&d_queries, 0), (&d_keys, 1)] {
                    let expected = sum(of);
                    assert_within(
                        &format!("input {of}, {what}"),
                        found,
                        &expected,
                        1e-5 * largest(&expected).max(1.0),
                    );
                }
                for (expected, (_, grad)) in expected.iter().zip(&gatherings) {
                    let found = weights.gather_backward(&queries, &keys, grad);
                    assert_close(&format!("values, {what}"), &found, &expected[2], 5e-6);
                }
                let in_strips = weights.backward_in_strips(&queries, &keys, &gathered, &of_log_sums, 0);
                assert!(in_strips == [d_queries, d_keys], "strips, {what}");
            }
        }
    }
}

#[test]
fn kept_weights_stay_within_the_bytes_allowed_and_so_do_those_for_gradients() {
    let [queries, keys, values] = image(450);
    let isa = Isa::best();
    let panel = panel_columns(isa) * 450 * size_of::<f32>();
    let group = panels::PANELS * panel;
    for panels in [0, 3, 4, 7, 8] {
        let weights = AttentionWeights::new(isa, Precision::F32, [&queries, &keys], 450, panels * panel);
        let once = weights.kept_bytes();
        assert!(once <= panels * panel && once + group > panels * panel, "{once} of {panels} panels");
        weights.gather_backward(&queries, &keys, &values);
        assert_eq!(weights.kept_bytes(), 2 * once);
    }
}

#[test]
fn scores_of_any_size_give_weights_that_sum_to_one() {
    let pixels = 200;
    for scale in [1e-20, 1.0, 1e4, 1e15] {
        let queries: Vec<f32> = values(CHANNELS * pixels, 4).into_iter().map(|x| scale * x).collect();
        let keys = values(CHANNELS * pixels, 5);
        let out = attention(&queries, &keys, &vec![1.0; 2 * pixels], [1, CHANNELS, pixels]);
        assert_close(&format!("scale {scale}"), &out, &vec![1.0; 2 * pixels], 1e-5);
    }
}

#[test]
fn images_do_not_see_each_other_and_results_do_not_depend_on_threads() {
    let pixels = 300;
    let [mut queries, mut keys, mut values] = image(pixels);
    let alone = attention(&queries, &keys, &values, [1, CHANNELS, pixels]);
    let gradients_alone = attention_backward(&queries, &keys, &values, &values, [1, CHANNELS, pixels]);
    for x in [&mut queries, &mut keys, &mut values] {
        let other: Vec<f32> = x.iter().map(|x| 0.5 - x).collect();
        x.extend(other);
    }
    let with = |threads: usize| {
        let sizes = [2, CHANNELS, pixels];
        with_threads(threads, || {
            let gradients = attention_backward(&queries, &keys, &values, &values, sizes);
            (attention(&queries, &keys, &values, sizes), gradients)
        })
    };
    let (both, gradients) = with(1);
    assert!((both.clone(), gradients.clone()) == with(3));
    assert!(both[..alone.len()] == alone);
    for (both, alone) in gradients.iter().zip(gradients_alone) {
        assert!(both[..alone.len()] == alone);
    }
}

/// Not a number goes in, and comes out where the definition has it: NaN (also one with a payload) and infinity, in the first
/// block of pixels and in the last.
#[test]
fn what_is_not_a_number_is_not_turned_into_one() {
    let pixels = 300;
    let [queries, keys, values] = image(pixels);
    let nans = |x: &[f64]| -> Vec<bool> { x.iter().map(|x| x.is_nan()).collect() };
    let is_nan = |x: &[f32]| nans(&wide(x));
    for bad in [f32::NAN, f32::from_bits(0x7FC0_0001), f32::INFINITY] {
        for (input, pixel) in [(0, 5), (0, 299), (1, 5), (1, 270), (2, 5)] {
            let mut inputs = [queries.clone(), keys.clone(), values.clone()];
            inputs[input][pixel] = bad;
            let [queries, keys, values] = &inputs;
            let [q, k, v] = inputs.each_ref().map(|input| wide(input));
            let expected = nans(&reference::attention(&q, &k, &v, pixels));
            let gradients = reference::attention_backward(&q, &k, &v, &v, pixels);
            assert!(expected.contains(&true) || bad.is_infinite() && input == 2);
            for isa in Isa::to_test() {
                for kept_bytes in [0, usize::MAX] {
                    let what =
                        format!("{bad} in input {input} at {pixel}, {isa:?}, {kept_bytes} bytes allowed");
                    let weights =
                        AttentionWeights::new(isa, Precision::F32, [queries, keys], pixels, kept_bytes);
                    let gathered = weights.gather(values);
                    assert!(is_nan(&gathered) == expected, "{what}");
                    if bad.is_infinite() {
                        continue; // the definition's gradients multiply infinity by weights of zero, which are tiny here
                    }
                    let of_values = weights.gather_backward(queries, keys, values);
                    assert!(is_nan(&of_values) == nans(&gradients[2]), "values, {what}");
                    let gathered = Gathered { values, gathered: &gathered, grad: values };
                    let [d_queries, d_keys] =
                        weights.backward(queries, keys, &[gathered], &vec![0.0; pixels]);
                    assert!(is_nan(&d_queries) == nans(&gradients[0]), "queries, {what}");
                    assert!(is_nan(&d_keys) == nans(&gradients[1]), "keys, {what}");
                }
            }
        }
    }
}

/// As when all products with a key overflow.
#[test]
fn scores_of_minus_infinity_have_no_weight() {
    let pixels = 300;
    let queries = vec![1.0; pixels];
    let mut keys = vec![f32::NEG_INFINITY; pixels];
    let values = values(pixels, 1);
    for isa in Isa::to_test() {
        let gather = |keys: &[f32]| {
            AttentionWeights::new(isa, Precision::F32, [&queries, keys], pixels, 0).gather(&values)
        };
        assert!(gather(&keys).iter().all(|x| x.is_nan()), "{isa:?}, as in the definition");
        keys[299] = -3.0;
        assert!(gather(&keys).iter().all(|&x| (x - values[299]).abs() < 1e-6), "{isa:?}");
        keys[299] = f32::NEG_INFINITY;
    }
}

/// Values gathered twice, and the logarithms of the sums; on other devices by the whole matrix of all pairs, and by pieces of two rows and of one.
pub(crate) fn cases() -> Vec<Case> {
    let case = |[batch, channels, height, width]: [usize; 4], kept_bytes, piece_bytes| {
        let gather = |attention: tensor::Attention, values: Tensor<4>| {
            let gathered = attention.gather(values.clone()) + attention.gather(values * 0.5);
            Tensor::cat(vec![gathered, attention.log_sums()], 1)
        };
        let tensors = |inputs: Vec<_>| array(inputs.into_iter().map(Tensor::from_dispatch).collect());
        let pixels = height * width;
        let image = move |x: &[f64], n: usize| x[n * x.len() / batch..][..x.len() / batch].to_vec();
        let map = [batch, channels, height, width];
        Case::new(
            &format!("attention of {pixels} pixels, {kept_bytes} bytes kept, {piece_bytes} a piece"),
            &[&map, &map, &[batch, 2, height, width]],
            move |inputs| {
                let [queries, keys, values] = tensors(inputs);
                gather(tensor::Attention::new(queries, keys, kept_bytes), values)
            },
            move |x| {
                let of_image = |n| {
                    let [queries, keys, values] = [0, 1, 2].map(|input| image(&x[input], n));
                    let gathered = reference::attention(&queries, &keys, &values, pixels);
                    let log_sums = reference::log_sums(&queries, &keys, pixels);
                    gathered.into_iter().map(|x| 1.5 * x).chain(log_sums)
                };
                (0..batch).flat_map(of_image).collect()
            },
            move |x, grad| {
                let of_image = |n| {
                    let [queries, keys, values] = [0, 1, 2].map(|input| image(&x[input], n));
                    let grad = image(grad, n);
                    let (of_gathered, of_log_sums) = grad.split_at(2 * pixels);
                    let of_gathered: Vec<f64> = of_gathered.iter().map(|x| 1.5 * x).collect();
                    let [mut of_queries, mut of_keys, of_values] =
                        reference::attention_backward(&queries, &keys, &values, &of_gathered, pixels);
                    let by_log_sums = reference::log_sums_backward(&queries, &keys, of_log_sums, pixels);
                    for (sum, more) in [&mut of_queries, &mut of_keys].into_iter().zip(by_log_sums) {
                        sum.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
                    }
                    [of_queries, of_keys, of_values]
                };
                let images: Vec<[Vec<f64>; 3]> = (0..batch).map(of_image).collect();
                [0, 1, 2].map(|input| images.iter().flat_map(|image| &image[input]).copied().collect()).into()
            },
        )
        .or(move |inputs| {
            let [queries, keys, values] = tensors(inputs);
            gather(tensor::Attention::in_pieces(queries, keys, kept_bytes, piece_bytes), values)
        })
        .change(0, |_, query| 3.0 * query)
    };
    vec![
        case([2, 3, 4, 5], 0, usize::MAX),
        case([2, 3, 4, 5], usize::MAX, 2 * 20 * 4),
        case([2, 9, 17, 19], 0, 1),
    ]
}

/// The whole image, windows, and windows that are moved; of more pixels than a block, of one, of fewer than a panel.
pub(crate) fn windowed_cases() -> Vec<Case> {
    let case = |[channels, height, width]: [usize; 3], windows: Windows| {
        let map = [2, channels, height, width];
        let image = move |x: &[f64], n: usize| x[n * x.len() / 2..][..x.len() / 2].to_vec();
        let inputs = move |x: &[Vec<f64>], n| [0, 1, 2].map(|input| image(&x[input], n));
        let tensors = |inputs: Vec<_>| array::<_, 3>(inputs.into_iter().map(Tensor::from_dispatch).collect());
        let [kernel, composed, forward, backward] = std::array::from_fn(|_| windows.clone());
        Case::new(
            &format!("attention of {height}x{width} in {windows:?}"),
            &[&map, &map, &[2, 5, height, width]],
            move |inputs| {
                let [queries, keys, values] = tensors(inputs);
                tensor::attention(queries, keys, values, &kernel)
            },
            move |x| {
                let of_image = |n| {
                    let [queries, keys, values] = inputs(x, n);
                    reference::windowed_attention(&queries, &keys, &values, &forward)
                };
                (0..2).flat_map(of_image).collect()
            },
            move |x, grad| {
                let images: [[Vec<f64>; 3]; 2] = [0, 1].map(|n| {
                    let [queries, keys, values] = inputs(x, n);
                    let grad = image(grad, n);
                    reference::windowed_attention_backward(&queries, &keys, &values, &grad, &backward)
                });
                [0, 1, 2].map(|input| images.iter().flat_map(|image| &image[input]).copied().collect()).into()
            },
        )
        .or(move |inputs| {
            let [queries, keys, values] = tensors(inputs);
            tensor::attention_in_pieces(queries, keys, values, composed.clone(), usize::MAX)
        })
        .change(0, |_, query| 3.0 * query)
    };
    vec![
        case([3, 17, 19], Windows::split([17, 19], 1)),
        case([4, 6, 8], Windows::split([6, 8], 2)),
        case([4, 6, 8], Windows::shifted([6, 8], 2)),
        case([3, 9, 3], Windows::shifted([9, 3], 3)),
    ]
}

#[test]
fn moved_windows_are_cut_at_the_edges() {
    let windows = |windows: Windows| -> Vec<[Vec<usize>; 2]> {
        let window = |window: super::windows::Window| [window.rows.collect(), window.columns.collect()];
        windows.each().into_iter().map(window).collect()
    };
    let bands = |windows: Vec<[Vec<usize>; 2]>, axis: usize| {
        let mut bands: Vec<Vec<usize>> = windows.into_iter().map(|window| window[axis].clone()).collect();
        bands.dedup();
        bands
    };
    assert_eq!(bands(windows(Windows::split([6, 3], 3)), 0), [[0, 1], [2, 3], [4, 5]]);
    assert_eq!(bands(windows(Windows::shifted([6, 3], 3)), 0), [vec![0], vec![1, 2], vec![3, 4], vec![5]]);
    assert_eq!(bands(windows(Windows::shifted([6, 4], 2)), 0), [vec![0], vec![1, 2, 3], vec![4, 5]]);
    assert_eq!(bands(windows(Windows::shifted([2, 4], 2)), 0), [[0], [1]], "a pixel has no half");
    assert_eq!(windows(Windows::shifted([4, 4], 2)).len(), 9);
}

/// Scores that grow from block to block, so that what was summed is scaled again, and those of not a number.
#[test]
fn each_instruction_set_attends_as_the_definition() {
    for pixels in [1, 30, 131, 600] {
        let [queries, mut keys, values] = image(pixels);
        for growing in [false, true] {
            if growing {
                keys.iter_mut()
                    .enumerate()
                    .for_each(|(i, key)| *key *= (1 + i % pixels) as f32 / pixels as f32);
            }
            let expected = reference::attention(&wide(&queries), &wide(&keys), &wide(&values), pixels);
            for isa in Isa::to_test() {
                let (found, _) =
                    super::windows::attend(isa, Precision::F32, [&queries, &keys, &values], pixels);
                let what = format!("{pixels} pixels, {isa:?}, growing: {growing}");
                assert_close(&what, &found, &expected, 5e-6);
            }
        }
    }
}

#[test]
fn attention_in_windows_does_not_hide_what_is_not_a_number() {
    let pixels = 600;
    let sound = image(pixels);
    let nans = |x: &[f64]| -> Vec<bool> { x.iter().map(|x| x.is_nan()).collect() };
    for (input, pixel) in [(0, 5), (0, 599), (1, 5), (1, 270), (1, 599), (2, 5)] {
        let mut inputs = sound.clone();
        inputs[input][pixel] = f32::NAN;
        let [q, k, v] = inputs.each_ref().map(|input| wide(input));
        let expected = nans(&reference::attention(&q, &k, &v, pixels));
        for isa in Isa::to_test() {
            let [queries, keys, values] = &inputs;
            let (found, _) = super::windows::attend(isa, Precision::F32, [queries, keys, values], pixels);
            assert!(nans(&wide(&found)) == expected, "in input {input} at {pixel}, {isa:?}");
        }
    }
    let out = |keys: &[f32]| {
        super::windows::attend(Isa::best(), Precision::F32, [&sound[0], keys, &sound[2]], pixels).0
    };
    assert!(out(&vec![f32::NEG_INFINITY; sound[1].len()]).iter().all(|x| x.is_nan()), "as in the definition");
}

/// Scores and weights of bfloat16: what is gathered is off by less than a percent of the largest value.
#[test]
fn attention_at_bfloat16_is_near_the_definition_and_the_same_without_amx() {
    let pixels = 450;
    let [queries, keys, values] = image(pixels);
    // Scores of a few units, whose rounding changes weights by about a percent.
    let [queries, keys] = [queries, keys].map(|x| x.into_iter().map(|x| x / 3.0).collect::<Vec<f32>>());
    let expected = reference::attention(&wide(&queries), &wide(&keys), &wide(&values), pixels);
    let gather = |isa, kept_bytes| {
        AttentionWeights::new(isa, Precision::Bf16, [&queries, &keys], pixels, kept_bytes).gather(&values)
    };
    let first = gather(Isa::best(), 0);
    let without_amx = gather(Isa::to_test().next().expect("the portable one"), 0);
    assert_close("bfloat16, in steps", &without_amx, &expected, 1e-2);
    assert_close("bfloat16", &first, &expected, 1e-2);
    let (attended, _) =
        super::windows::attend(Isa::best(), Precision::Bf16, [&queries, &keys, &values], pixels);
    assert_close("bfloat16, once", &attended, &expected, 1e-2);
    for isa in Isa::to_test() {
        let same = if isa.sums_bf16_in_tiles() { &first } else { &without_amx };
        for kept_bytes in [0, usize::MAX] {
            assert!(gather(isa, kept_bytes) == *same, "{isa:?}, {kept_bytes} bytes allowed");
        }
    }
}
