use srflow_simd::{Activation, Isa};

use super::backward::{backward_input_with, backward_weight_with};
use super::forward::depthwise_with;
use super::*;
use crate::conv2d::Epilogue;
use crate::convolution::Convolved;
use crate::operation::tests::Case;
use crate::operation::{apply, array};
use crate::test_values::{assert_close, values};

const TOLERANCE: f32 = 2e-6;

fn shape(channels: usize, input: [usize; 2], kernel: [usize; 2], padding: [usize; 2]) -> DepthwiseShape {
    DepthwiseShape { batch: 2, channels, input, kernel, padding }
}

fn shapes() -> Vec<DepthwiseShape> {
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
        let bias = values(shape.channels, 3);
        let grad = values(shape.output_len(), 4);
        let residual = values(shape.output_len(), 10);
        let epilogue =
            Epilogue { bias: Some(&bias), residual: Some(&residual), activation: Activation::Gelu };
        let out = reference::depthwise(&input, &weight, &epilogue, &shape);
        let d_input = reference::depthwise_backward_input(&grad, &weight, &shape);
        let d_weight = reference::depthwise_backward_weight(&input, &grad, &shape);
        for isa in Isa::to_test() {
            let check = |what: &str, found: &[f32], expected: &[f32]| {
                assert_close(&format!("{what}, {isa:?}, {shape:?}"), found, expected, TOLERANCE);
            };
            check("output", &depthwise_with(isa, &input, &weight, &epilogue, &shape), &out);
            check("input gradient", &backward_input_with(isa, &grad, &weight, None, &shape), &d_input);
            check("weight gradient", &backward_weight_with(isa, &input, &grad, &shape), &d_weight);
        }
    }
}

#[test]
fn results_do_not_depend_on_threads_and_outputs_not_on_the_instruction_set() {
    let shape = shape(5, [20, 45], [7, 7], [3, 3]);
    let (input, weight) = (values(shape.input_len(), 5), values(shape.weight_len(), 6));
    let grad = values(shape.output_len(), 7);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| {
            (
                depthwise(&input, &weight, &Epilogue::default(), &shape),
                depthwise_backward_weight(&input, &grad, &shape),
            )
        })
    };
    assert!(run(1) == run(3));
    let outputs: Vec<_> = Isa::to_test()
        .map(|isa| depthwise_with(isa, &input, &weight, &Epilogue::default(), &shape))
        .collect();
    assert!(outputs.windows(2).all(|pair| pair[0] == pair[1]));
}

/// Each with bias and residual.
pub(crate) fn cases() -> Vec<Case> {
    let case = |shape: DepthwiseShape, activation| {
        let DepthwiseShape { batch, channels, input, kernel, padding } = shape;
        let [height, width] = shape.output();
        let shapes: [&[usize]; 4] = [
            &[batch, channels, input[0], input[1]],
            &[channels, 1, kernel[0], kernel[1]],
            &[channels],
            &[batch, channels, height, width],
        ];
        let operation = Convolved { convolution: tensor::Depthwise { padding }, activation };
        Case::of(&format!("{shape:?}, {activation:?}"), operation, shapes, move |x| {
            let epilogue = Epilogue { bias: Some(&x[2]), residual: Some(&x[3]), activation };
            reference::depthwise(&x[0], &x[1], &epilogue, &shape)
        })
        .change(1, move |_, weight| weight * (3.0 / (kernel[0] * kernel[1]) as f32).sqrt())
    };
    let sizes = [
        case(shape(3, [7, 9], [5, 5], [2, 2]), Activation::Identity),
        case(shape(3, [8, 9], [5, 3], [1, 0]), Activation::Tanh),
        case(shape(6, [12, 19], [15, 15], [7, 7]), Activation::Sigmoid).slopes(10),
    ];
    sizes.into_iter().chain([residual_that_is_the_input()]).collect()
}

fn residual_that_is_the_input() -> Case {
    let shape = shape(3, [9, 11], [7, 7], [3, 3]);
    let (activation, convolution) = (Activation::Gelu, tensor::Depthwise { padding: shape.padding });
    let operation = Convolved { convolution, activation };
    let shapes: [&[usize]; 3] = [&[2, 3, 9, 11], &[3, 1, 7, 7], &[3]];
    Case::new(
        "residual that is the input",
        &shapes,
        move |inputs| {
            let [input, weight, bias] = array(inputs);
            apply(operation.clone(), [input.clone(), weight, bias, input])
        },
        move |x| {
            let epilogue = Epilogue { bias: Some(&x[2]), residual: Some(&x[0]), activation };
            reference::depthwise(&x[0], &x[1], &epilogue, &shape)
        },
    )
    .change(1, |_, weight| 0.3 * weight)
}
