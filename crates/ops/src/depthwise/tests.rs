use srflow_simd::{Activation, Isa, Precision};

use super::backward::{backward_input_with, backward_weight_with};
use super::forward::depthwise_with;
use super::*;
use crate::conv2d::Epilogue;
use crate::convolution::reference::{self, Operands};
use crate::convolution::tests::{Residual, case};
use crate::convolution::{Conv2dShape, Kernels};
use crate::operation::tests::Case;
use crate::test_values::{assert_close, rounded, values, wide, with_threads};

const TOLERANCE: f64 = 2e-6;

fn shape(channels: usize, input: [usize; 2], kernel: [usize; 2], padding: [usize; 2]) -> Conv2dShape {
    let [in_channels, out_channels, groups] = [channels; 3];
    Conv2dShape { batch: 2, in_channels, out_channels, groups, input, kernel, stride: [1, 1], padding }
}

fn shapes() -> Vec<Conv2dShape> {
    vec![
        shape(3, [21, 70], [15, 15], [7, 7]),
        shape(2, [6, 64], [7, 7], [3, 3]),
        shape(2, [9, 33], [1, 1], [0, 0]),
        shape(1, [3, 2], [15, 15], [7, 7]),
        shape(2, [8, 17], [3, 5], [0, 2]),
        shape(2, [8, 9], [4, 6], [1, 1]),
    ]
}

#[test]
fn each_instruction_set_computes_the_definition() {
    for shape in shapes() {
        let input = values(shape.input_len(), 1);
        let weight = values(shape.weight_len(), 2);
        let bias = values(shape.out_channels, 3);
        let grad = values(shape.output_len(), 4);
        let residual = values(shape.output_len(), 10);
        let epilogue =
            Epilogue { bias: Some(&bias), residual: Some(&residual), activation: Activation::Gelu };
        let [wide_input, wide_weight, wide_bias, wide_grad, wide_residual] =
            [&input, &weight, &bias, &grad, &residual].map(|values| wide(values));
        let operands = Operands {
            input: &wide_input,
            weight: &wide_weight,
            bias: &wide_bias,
            residual: Some(&wide_residual),
            activation: Activation::Gelu,
        };
        let out = reference::convolve(&operands, &shape);
        let d_input = reference::backward_input(&wide_grad, &wide_weight, &shape);
        let d_weight = reference::backward_weight(&wide_input, &wide_grad, &shape);
        for isa in Isa::to_test() {
            let check = |what: &str, found: &[f32], expected: &[f64]| {
                assert_close(&format!("{what}, {isa:?}, {shape:?}"), found, expected, TOLERANCE);
            };
            check("output", &depthwise_with(isa, Precision::F32, &input, &weight, &epilogue, &shape), &out);
            check(
                "input gradient",
                &backward_input_with(isa, Precision::F32, [&grad, &weight], None, &shape),
                &d_input,
            );
            check("weight gradient", &backward_weight_with(isa, &input, &grad, &shape), &d_weight);
        }
    }
}

#[test]
fn at_bfloat16_each_instruction_set_computes_the_definition_of_rounded_numbers() {
    for shape in shapes().into_iter().filter(|shape| shape.kernel[1] > 1) {
        let (input, weight) = (values(shape.input_len(), 1), values(shape.weight_len(), 2));
        let (bias, grad) = (values(shape.out_channels, 3), values(shape.output_len(), 4));
        let epilogue = Epilogue { bias: Some(&bias), residual: None, activation: Activation::Identity };
        let [near_input, near_weight, near_grad] = [&input, &weight, &grad].map(|values| rounded(values));
        let operands = Operands {
            input: &near_input,
            weight: &near_weight,
            bias: &wide(&bias),
            residual: None,
            activation: Activation::Identity,
        };
        let out = reference::convolve(&operands, &shape);
        let d_input = reference::backward_input(&near_grad, &near_weight, &shape);
        let found = |isa| {
            let out = depthwise_with(isa, Precision::Bf16, &input, &weight, &epilogue, &shape);
            [out, backward_input_with(isa, Precision::Bf16, [&grad, &weight], None, &shape)]
        };
        let first = found(Isa::best());
        assert_close(&format!("output, {shape:?}"), &first[0], &out, TOLERANCE);
        assert_close(&format!("input gradient, {shape:?}"), &first[1], &d_input, TOLERANCE);
        for isa in Isa::to_test() {
            assert!(found(isa) == first, "{isa:?}: other bits, {shape:?}");
        }
    }
}

#[test]
fn results_do_not_depend_on_threads_and_outputs_not_on_the_instruction_set() {
    let shape = shape(5, [20, 45], [7, 7], [3, 3]);
    let (input, weight) = (values(shape.input_len(), 5), values(shape.weight_len(), 6));
    let grad = values(shape.output_len(), 7);
    let run = |threads: usize| {
        with_threads(threads, || {
            (
                depthwise(&input, &weight, &Epilogue::default(), &shape),
                depthwise_backward_weight(&input, &grad, &shape),
            )
        })
    };
    assert!(run(1) == run(3));
    let outputs: Vec<_> = Isa::to_test()
        .map(|isa| depthwise_with(isa, Precision::F32, &input, &weight, &Epilogue::default(), &shape))
        .collect();
    assert!(outputs.windows(2).all(|pair| pair[0] == pair[1]));
}

pub(crate) fn cases() -> Vec<Case> {
    let case = |shape, activation, residual| case(Kernels::Depthwise, shape, activation, residual);
    vec![
        case(shape(3, [7, 9], [5, 5], [2, 2]), Activation::Identity, Residual::None),
        case(shape(3, [8, 9], [5, 3], [1, 0]), Activation::Tanh, Residual::Other),
        case(shape(6, [12, 19], [15, 15], [7, 7]), Activation::Sigmoid, Residual::Other),
        case(shape(3, [9, 11], [7, 7], [3, 3]), Activation::Gelu, Residual::Input),
    ]
}
