use super::backward::{backward_input_with, backward_weight_with};
use super::forward::depthwise_with;
use super::*;
use crate::activation::Activation;
use crate::conv2d::Epilogue;
use crate::simd::Isa;
use crate::test_values::values;

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

fn assert_close(what: &str, shape: &DepthwiseShape, isa: Isa, found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len(), "{what} {shape:?}");
    let scale = expected.iter().fold(1.0_f32, |m, x| m.max(x.abs()));
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!(
            (found - expected).abs() <= 2e-6 * scale,
            "{what} {isa:?} {shape:?} [{i}]: {found} for {expected}"
        );
    }
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
        for isa in Isa::available() {
            assert_close(
                "output",
                &shape,
                isa,
                &depthwise_with(isa, &input, &weight, &epilogue, &shape),
                &out,
            );
            let found = backward_input_with(isa, &grad, &weight, &shape);
            assert_close("input gradient", &shape, isa, &found, &d_input);
            let found = backward_weight_with(isa, &input, &grad, &shape);
            assert_close("weight gradient", &shape, isa, &found, &d_weight);
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
    let outputs: Vec<_> = Isa::available()
        .into_iter()
        .map(|isa| depthwise_with(isa, &input, &weight, &Epilogue::default(), &shape))
        .collect();
    assert!(outputs.windows(2).all(|pair| pair[0] == pair[1]));
}
