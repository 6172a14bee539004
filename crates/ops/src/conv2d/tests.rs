use srflow_simd::{Isa, Precision};

use super::backward::backward_input_with;
use super::forward::conv2d_with;
use super::weight_gradient::backward_weight_with;
use super::*;
use crate::convolution::reference::{self, Operands};
use crate::convolution::tests::{Residual, case};
use crate::convolution::{Conv2dShape, Kernels};
use crate::operation::tests::{ACTIVATIONS, Case};
use crate::precision::with_precision;
use crate::test_values::{assert_close, rounded, values, wide, with_threads};

fn shape(
    channels: [usize; 2],
    input: [usize; 2],
    kernel: [usize; 2],
    stride: usize,
    padding: [usize; 2],
) -> Conv2dShape {
    Conv2dShape {
        batch: 2,
        in_channels: channels[0],
        out_channels: channels[1],
        groups: 1,
        input,
        kernel,
        stride: [stride; 2],
        padding,
    }
}

/// The kernels of the networks at sizes that leave every kind of remainder, and some that no network has.
fn shapes() -> Vec<Conv2dShape> {
    vec![
        shape([5, 9], [7, 50], [3, 3], 1, [1, 1]),
        shape([3, 8], [19, 37], [7, 7], 2, [3, 3]),
        shape([4, 6], [12, 21], [3, 3], 2, [1, 1]),
        shape([16, 10], [9, 33], [1, 1], 1, [0, 0]),
        shape([4, 7], [9, 34], [1, 1], 2, [0, 0]),
        shape([6, 16], [8, 48], [1, 5], 1, [0, 2]),
        shape([6, 3], [8, 49], [5, 1], 1, [2, 0]),
        shape([2, 2], [70, 65], [3, 3], 1, [1, 1]),
        shape([3, 2], [1, 1], [3, 3], 1, [1, 1]),
        shape([2, 3], [5, 6], [2, 2], 2, [0, 0]),
        shape([2, 3], [6, 5], [3, 2], 3, [2, 1]),
        shape([2, 1], [4, 4], [1, 1], 1, [2, 2]),
        shape([20, 8], [3, 100], [3, 3], 1, [0, 0]),
        shape([51, 9], [2, 530], [1, 1], 1, [0, 0]),
    ]
}

/// Those that Winograd's way applies to, with channels and tiles of every remainder.
fn shapes_of_few_products() -> Vec<Conv2dShape> {
    vec![
        shape([20, 25], [9, 50], [3, 3], 1, [1, 1]),
        shape([16, 17], [13, 7], [3, 3], 1, [1, 1]),
        shape([18, 16], [6, 9], [3, 3], 1, [0, 2]),
        shape([33, 40], [5, 61], [1, 5], 1, [0, 2]),
        shape([16, 18], [23, 61], [5, 1], 1, [2, 0]),
        shape([16, 16], [1, 1], [3, 3], 1, [1, 1]),
        shape([17, 16], [70, 3], [3, 3], 1, [1, 1]),
        shape([16, 19], [3, 300], [3, 3], 1, [1, 1]),
        shape([16, 17], [3, 2], [3, 3], 1, [14, 40]),
    ]
}

#[test]
fn each_instruction_set_computes_the_definition() {
    let direct = shapes().into_iter().map(|shape| (shape, 2e-6));
    // Transforms lose a digit.
    let transformed = shapes_of_few_products().into_iter().map(|shape| (shape, 2e-5));
    for (shape, tolerance) in direct.chain(transformed) {
        let input = values(shape.input_len(), 1);
        let weight = values(shape.weight_len(), 2);
        let bias = values(shape.out_channels, 3);
        let grad = values(shape.output_len(), 4);
        let residual = values(shape.output_len(), 10);
        let epilogue =
            Epilogue { bias: Some(&bias), residual: Some(&residual), activation: Activation::Relu };
        let [wide_input, wide_weight, wide_bias, wide_grad, wide_residual] =
            [&input, &weight, &bias, &grad, &residual].map(|values| wide(values));
        let operands = Operands {
            input: &wide_input,
            weight: &wide_weight,
            bias: &wide_bias,
            residual: Some(&wide_residual),
            activation: Activation::Relu,
        };
        let out = reference::convolve(&operands, &shape);
        let d_input = reference::backward_input(&wide_grad, &wide_weight, &shape);
        let d_weight = reference::backward_weight(&wide_input, &wide_grad, &shape);
        let [height, width] = shape.output();
        let d_bias = conv2d_backward_bias(&grad, shape.out_channels, height * width);
        let expected = reference::backward_bias(&wide_grad, &shape);
        assert_close(&format!("bias gradient, {shape:?}"), &d_bias, &expected, tolerance);
        for isa in Isa::to_test() {
            let check = |what: &str, found: &[f32], expected: &[f64]| {
                assert_close(&format!("{what}, {isa:?}, {shape:?}"), found, expected, tolerance);
            };
            check("output", &conv2d_with(isa, &input, &weight, &epilogue, &shape), &out);
            check("input gradient", &backward_input_with(isa, &grad, &weight, &shape), &d_input);
            // Each element is a sum over all pixels of all images.
            let found = backward_weight_with(isa, Precision::F32, &input, &grad, &shape);
            assert_close(&format!("weight gradient, {isa:?}, {shape:?}"), &found, &d_weight, 2e-5);
        }
    }
}

#[test]
fn results_do_not_depend_on_threads_and_outputs_not_on_the_instruction_set() {
    for channels in [[12, 20], [20, 20]] {
        check_that_results_do_not_depend_on_the_machine(shape(channels, [33, 61], [3, 3], 1, [1, 1]));
    }
}

fn check_that_results_do_not_depend_on_the_machine(shape: Conv2dShape) {
    let (input, weight) = (values(shape.input_len(), 5), values(shape.weight_len(), 6));
    let grad = values(shape.output_len(), 7);
    let run = |threads: usize| {
        with_threads(threads, || {
            (
                conv2d(&input, &weight, &Epilogue::default(), &shape),
                conv2d_backward_input(&grad, &weight, &shape),
                conv2d_backward_weight(&input, &grad, &shape),
                conv2d_backward_bias(&grad, 20, 33 * 61),
            )
        })
    };
    assert!(run(1) == run(3));
    let outputs: Vec<_> =
        Isa::to_test().map(|isa| conv2d_with(isa, &input, &weight, &Epilogue::default(), &shape)).collect();
    assert!(outputs.windows(2).all(|pair| pair[0] == pair[1]));
}

/// Products of bfloat16 are those of rounded operands. Winograd's way rounds what it transformed: its error is about one percent
/// of the typical result.
#[test]
fn at_bfloat16_each_instruction_set_computes_the_definition_of_rounded_numbers() {
    let direct = [
        shape([16, 19], [9, 33], [1, 1], 1, [0, 0]),
        shape([21, 24], [11, 14], [3, 3], 2, [1, 1]),
        shape([16, 16], [8, 49], [2, 5], 1, [0, 2]),
    ];
    let transformed = shapes_of_few_products();
    for (shape, exact) in direct
        .into_iter()
        .map(|shape| (shape, true))
        .chain(transformed.into_iter().map(|shape| (shape, false)))
    {
        let input = values(shape.input_len(), 1);
        let weight = values(shape.weight_len(), 2);
        let bias = values(shape.out_channels, 3);
        let grad = values(shape.output_len(), 4);
        let epilogue = Epilogue { bias: Some(&bias), residual: None, activation: Activation::Identity };
        let [near_input, near_weight, near_grad] = [&input, &weight, &grad].map(|values| rounded(values));
        let operands = Operands {
            input: &near_input,
            weight: &near_weight,
            bias: &wide(&bias),
            residual: None,
            activation: Activation::Identity,
        };
        let expected = [
            reference::convolve(&operands, &shape),
            reference::backward_input(&near_grad, &near_weight, &shape),
            reference::backward_weight(&near_input, &near_grad, &shape),
        ];
        let found = |isa| {
            with_precision(crate::Precision::Bf16, || {
                [
                    conv2d_with(isa, &input, &weight, &epilogue, &shape),
                    backward_input_with(isa, &grad, &weight, &shape),
                    backward_weight_with(isa, Precision::Bf16, &input, &grad, &shape),
                ]
            })
        };
        let first = found(Isa::to_test().next().expect("the portable one"));
        for isa in Isa::to_test() {
            let found = found(isa);
            for (number, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let tolerance = if exact || number == 2 { 2e-5 } else { 3e-2 };
                assert_close(&format!("result {number} of {shape:?}, {isa:?}"), found, expected, tolerance);
            }
            let same_order = !isa.sums_bf16_in_tiles();
            assert!(!same_order || found[..2] == first[..2], "{isa:?}: other bits, {shape:?}");
        }
    }
}

#[test]
fn a_kernel_larger_than_the_padded_input_gives_nothing() {
    let shape = shape([1, 2], [2, 2], [5, 5], 1, [1, 1]);
    assert_eq!(shape.output(), [0, 0]);
    let input = values(shape.input_len(), 8);
    let weight = values(shape.weight_len(), 9);
    assert!(conv2d(&input, &weight, &Epilogue::default(), &shape).is_empty());
    assert_eq!(conv2d_backward_input(&[], &weight, &shape), vec![0.0; shape.input_len()]);
    assert_eq!(conv2d_backward_weight(&input, &[], &shape), vec![0.0; shape.weight_len()]);
    assert_eq!(conv2d_backward_bias(&[], 2, 0), [0.0; 2]);
}

/// Cloned options share their cache, also where another stride or padding wants the weight in another order.
#[test]
fn convolutions_that_share_a_cache_do_not_disturb_each_other() {
    let device = burn::tensor::Device::flex();
    let of = |shape: [usize; 4], seed| {
        let values = values(shape.iter().product(), seed);
        burn::tensor::Tensor::<4>::from_data(burn::tensor::TensorData::new(values, shape), &device)
    };
    let (input, weight) = (of([1, 16, 9, 8], 1), of([16, 16, 3, 3], 2));
    let run = |options: tensor::Conv2dOptions| -> Vec<f32> {
        let out = tensor::conv2d(input.clone(), weight.clone(), tensor::Epilogue::default(), options);
        out.into_data().try_to_vec().expect("numbers")
    };
    let first = tensor::Conv2dOptions::new([1, 1], [1, 1]);
    for (stride, padding) in [([1, 1], [1, 1]), ([2, 2], [1, 1]), ([1, 2], [0, 1]), ([1, 1], [1, 1])] {
        let shared = run(tensor::Conv2dOptions { stride, padding, ..first.clone() });
        assert!(shared == run(tensor::Conv2dOptions::new(stride, padding)), "{stride:?} {padding:?}");
    }
}

pub(crate) fn cases() -> Vec<Case> {
    let case = |shape, activation, residual| case(Kernels::Dense, shape, activation, residual);
    let small = shape([3, 5], [7, 9], [3, 3], 1, [1, 1]);
    let uneven = Conv2dShape { stride: [1, 2], ..shape([3, 5], [7, 9], [3, 5], 1, [0, 2]) };
    let mut cases: Vec<Case> =
        ACTIVATIONS.into_iter().map(|activation| case(small, activation, Residual::None)).collect();
    cases.extend([
        case(uneven, Activation::Sigmoid, Residual::None),
        case(shape([3, 5], [7, 9], [1, 1], 1, [0, 0]), Activation::Gelu, Residual::Other),
        case(shape([19, 24], [11, 14], [3, 3], 2, [1, 1]), Activation::Gelu, Residual::Other),
        case(shape([4, 4], [6, 7], [3, 3], 1, [1, 1]), Activation::Gelu, Residual::Input),
    ]);
    // Enough channels for Winograd's way.
    cases.extend([[3, 3], [1, 5], [5, 1]].map(|kernel| {
        let shape = shape([16, 17], [6, 7], kernel, 1, kernel.map(|size| size / 2));
        case(shape, Activation::Tanh, Residual::Other)
    }));
    cases
}

/// Kernels, strides and paddings of networks, with many channels; the last has too few to be rounded.
pub(crate) fn cases_of_16_bits() -> Vec<Case> {
    let shapes = [
        shape([32, 19], [9, 33], [1, 1], 1, [0, 0]),
        shape([64, 32], [9, 12], [3, 3], 1, [1, 1]),
        shape([21, 24], [11, 14], [3, 3], 2, [1, 1]),
        shape([16, 17], [9, 13], [1, 5], 1, [0, 2]),
        shape([16, 16], [9, 7], [3, 2], 1, [0, 1]),
        shape([16, 16], [9, 7], [1, 1], 2, [0, 0]),
        shape([2, 16], [9, 7], [3, 3], 1, [1, 1]),
    ];
    let mut cases: Vec<Case> = shapes
        .into_iter()
        .map(|shape| case(Kernels::Dense, shape, Activation::Identity, Residual::None))
        .collect();
    cases.push(case(
        Kernels::Dense,
        shape([16, 16], [6, 7], [3, 3], 1, [1, 1]),
        Activation::Relu,
        Residual::Input,
    ));
    cases
}
