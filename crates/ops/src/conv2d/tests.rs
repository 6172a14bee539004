use super::backward::{backward_input_with, backward_weight_with};
use super::forward::conv2d_with;
use super::*;
use crate::simd::Isa;
use crate::test_values::values;

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
    ]
}

fn assert_close(what: &str, shape: &Conv2dShape, isa: Isa, found: &[f32], expected: &[f32]) {
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
        let bias = values(shape.out_channels, 3);
        let grad = values(shape.output_len(), 4);
        let residual = values(shape.output_len(), 10);
        let epilogue =
            Epilogue { bias: Some(&bias), residual: Some(&residual), activation: Activation::Relu };
        let out = reference::conv2d(&input, &weight, &epilogue, &shape);
        let d_input = reference::conv2d_backward_input(&grad, &weight, &shape);
        let d_weight = reference::conv2d_backward_weight(&input, &grad, &shape);
        for isa in Isa::available() {
            let found = conv2d_with(isa, &input, &weight, &epilogue, &shape);
            assert_close("output", &shape, isa, &found, &out);
            let found = backward_input_with(isa, &grad, &weight, &shape);
            assert_close("input gradient", &shape, isa, &found, &d_input);
            let found = backward_weight_with(isa, &input, &grad, &shape);
            assert_close("weight gradient", &shape, isa, &found, &d_weight);
        }
    }
}

#[test]
fn results_do_not_depend_on_threads_and_outputs_not_on_the_instruction_set() {
    let shape = shape([12, 20], [33, 61], [3, 3], 1, [1, 1]);
    let (input, weight) = (values(shape.input_len(), 5), values(shape.weight_len(), 6));
    let grad = values(shape.output_len(), 7);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| {
            (
                conv2d(&input, &weight, &Epilogue::default(), &shape),
                conv2d_backward_input(&grad, &weight, &shape),
                conv2d_backward_weight(&input, &grad, &shape),
                conv2d_backward_bias(&grad, &shape),
            )
        })
    };
    assert!(run(1) == run(3));
    let outputs: Vec<_> = Isa::available()
        .into_iter()
        .map(|isa| conv2d_with(isa, &input, &weight, &Epilogue::default(), &shape))
        .collect();
    assert!(outputs.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn bias_gradient_is_the_sum_over_images_and_pixels() {
    let shape = shape([1, 3], [4, 5], [3, 3], 1, [1, 1]);
    let grad: Vec<f32> = (0..shape.output_len()).map(|i| (i / 20 % 3) as f32).collect();
    assert_eq!(conv2d_backward_bias(&grad, &shape), [0.0, 40.0, 80.0]);
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
}
