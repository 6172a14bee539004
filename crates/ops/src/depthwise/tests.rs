use srflow_simd::{Activation, Isa};

use super::backward::{backward_input_with, backward_weight_with};
use super::forward::depthwise_with;
use super::*;
use crate::conv2d::Epilogue;
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
        .into_iter()
        .map(|isa| depthwise_with(isa, &input, &weight, &Epilogue::default(), &shape))
        .collect();
    assert!(outputs.windows(2).all(|pair| pair[0] == pair[1]));
}
