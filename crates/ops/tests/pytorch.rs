//! Every operation and the gradients of all its inputs against those of PyTorch and ptlflow in double precision.
//!
//! Golden values: `tools/parity/ops.py`, whose rule for inputs is repeated here. `SRFLOW_TEST_DEVICE` names the device; see
//! docs/guides/gpu.md.

use std::sync::LazyLock;

use burn::tensor::{Device, Tensor, TensorData};
use srflow_ops::Activation;
use srflow_ops::attention::tensor::Attention;
use srflow_ops::attention::{self, Windows};
use srflow_ops::batch_norm::tensor::batch_norm;
use srflow_ops::conv_transpose2d::tensor::conv_transpose2d;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::correlation::tensor::Correlation;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::golden::{Golden, name_hash, noise, numbers};
use srflow_ops::gru;
use srflow_ops::instance_norm::tensor::{group_norm, instance_norm};
use srflow_ops::layer_norm::tensor::layer_norm;
use srflow_ops::pointwise::tensor::{LayerOptions, PointwiseLayer, pointwise_layers};
use srflow_ops::upsample::tensor::convex_upsample;
use srflow_ops::warp::tensor::warp;

const ACTIVATIONS: [(&str, Activation); 6] = [
    ("identity", Activation::Identity),
    ("relu", Activation::Relu),
    ("leaky relu", Activation::LeakyRelu),
    ("gelu", Activation::Gelu),
    ("tanh", Activation::Tanh),
    ("sigmoid", Activation::Sigmoid),
];
/// Of the largest number of a tensor.
const TOLERANCE: f32 = 5e-6;

/// Found once: to ask drivers for their devices takes time.
static DEVICE: LazyLock<Device> = LazyLock::new(|| {
    let name = std::env::var("SRFLOW_TEST_DEVICE");
    srflow_ops::device(name.as_deref().unwrap_or("cpu")).expect("the device of SRFLOW_TEST_DEVICE")
});

static GOLDEN: LazyLock<Golden> = LazyLock::new(|| Golden::read("tests/golden/pytorch.safetensors"));

/// Weights of variance 1 / fan_in; positions and displacements that leave the image; the rest in -1..1.
fn made_up<const D: usize>(case: &str, name: &str, shape: [usize; D], device: &Device) -> Tensor<D> {
    let seed = name_hash(&format!("{case} {name}"));
    let fan_in: usize = shape[1..].iter().product();
    let of_noise = |u: f32| match name {
        "coords" => 8.0 + 14.0 * u,
        "displacement" | "mask" => 4.0 * u,
        _ if name.ends_with("weight") => u * (3.0 / fan_in as f64).sqrt() as f32,
        _ => u,
    };
    let count: usize = shape.iter().product();
    let values: Vec<f32> = (0..count as u32).map(|i| of_noise(noise(i, seed))).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn assert_close<const D: usize>(name: &str, found: Tensor<D>, every: usize) {
    let expected = GOLDEN.values(name);
    let found: Vec<f32> = numbers(found).into_iter().step_by(every).collect();
    assert_eq!(found.len(), expected.len(), "{name}");
    let size = expected.iter().fold(0.0_f32, |size, x| size.max(x.abs()));
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("{name}: largest difference {worst:.1e} beside {size:.1e}");
    assert!(worst <= TOLERANCE * size, "{name}: {worst} beside {size}");
}

/// Holds the operation to PyTorch's, without and with gradients, and the gradient of each input. Of the output every
/// `every`th number is stored.
fn check_every(
    every: usize,
    case: &str,
    shapes: &[(&str, [usize; 4])],
    operation: impl Fn(Vec<Tensor<4>>) -> Tensor<4>,
) {
    let inputs = |device: &Device| -> Vec<Tensor<4>> {
        shapes.iter().map(|&(name, shape)| made_up(case, name, shape, device)).collect()
    };
    let output = format!("{case} output");
    assert_close(&output, operation(inputs(&DEVICE)), every);
    let tracking = DEVICE.clone().autodiff();
    let leaves: Vec<_> = inputs(&tracking).into_iter().map(Tensor::require_grad).collect();
    let found = operation(leaves.clone());
    let grad = made_up(case, "output", found.dims(), &tracking);
    let grads = (found.clone() * grad).sum().backward();
    assert_close(&output, found, every);
    for (leaf, (name, _)) in leaves.iter().zip(shapes) {
        assert_close(&format!("{case} {name}"), leaf.grad(&grads).expect(name), 1);
    }
}

fn check(case: &str, shapes: &[(&str, [usize; 4])], operation: impl Fn(Vec<Tensor<4>>) -> Tensor<4>) {
    check_every(1, case, shapes, operation);
}

/// What is applied to the sums, from the inputs behind input and weight: the bias, then perhaps something to add.
fn epilogue_of(inputs: &mut Vec<Tensor<4>>, activation: Activation) -> Epilogue {
    let residual = (inputs.len() == 4).then(|| inputs.remove(3));
    let epilogue = Epilogue::with(activation).bias(Some(inputs.remove(2).flatten(0, 3)));
    residual.into_iter().fold(epilogue, Epilogue::residual)
}

fn check_conv2d(
    name: &str,
    input: [usize; 4],
    weight: [usize; 4],
    [stride, padding]: [[usize; 2]; 2],
    activation: Activation,
    added: bool,
) {
    let mut shapes = vec![("input", input), ("weight", weight), ("bias", [weight[0], 1, 1, 1])];
    if added {
        let size = [0, 1].map(|i| (input[2 + i] + 2 * padding[i] - weight[2 + i]) / stride[i] + 1);
        shapes.push(("residual", [input[0], weight[0], size[0], size[1]]));
    }
    check(&format!("conv2d {name}"), &shapes, |mut inputs| {
        let epilogue = epilogue_of(&mut inputs, activation);
        let [input, weight] = inputs.try_into().expect("two");
        conv2d(input, weight, epilogue, Conv2dOptions::new(stride, padding))
    });
}

fn check_depthwise(
    name: &str,
    input @ [batch, channels, height, width]: [usize; 4],
    kernel: [usize; 2],
    padding: [usize; 2],
    activation: Activation,
    added: bool,
) {
    let mut shapes = vec![
        ("input", input),
        ("weight", [channels, 1, kernel[0], kernel[1]]),
        ("bias", [channels, 1, 1, 1]),
    ];
    if added {
        let size = [height + 2 * padding[0] - kernel[0] + 1, width + 2 * padding[1] - kernel[1] + 1];
        shapes.push(("residual", [batch, channels, size[0], size[1]]));
    }
    check(&format!("depthwise {name}"), &shapes, |mut inputs| {
        let epilogue = epilogue_of(&mut inputs, activation);
        let [input, weight] = inputs.try_into().expect("two");
        depthwise(input, weight, epilogue, padding)
    });
}

#[test]
fn convolutions_with_every_activation() {
    for (name, activation) in ACTIVATIONS {
        let options = [[1, 1], [1, 1]];
        check_conv2d(name, [2, 3, 7, 9], [5, 3, 3, 3], options, activation, false);
        check_conv2d(&format!("{name} added"), [2, 3, 7, 9], [5, 3, 3, 3], options, activation, true);
        check_depthwise(name, [2, 3, 9, 11], [7, 7], [3, 3], activation, false);
        check_depthwise(&format!("{name} added"), [2, 3, 9, 11], [7, 7], [3, 3], activation, true);
    }
}

/// The last three have enough channels for Winograd's way.
#[test]
fn convolutions_of_every_kind() {
    for (number, (input, outputs, kernel, options)) in [
        ([4, 5, 6], 9, [1, 1], [[1, 1], [0, 0]]),
        ([4, 7, 8], 9, [1, 1], [[2, 2], [0, 0]]),
        ([3, 7, 9], 5, [3, 3], [[2, 2], [1, 1]]),
        ([3, 7, 9], 5, [3, 5], [[1, 2], [0, 2]]),
        ([3, 13, 16], 9, [7, 7], [[2, 2], [3, 3]]),
        ([16, 6, 7], 17, [3, 3], [[1, 1], [1, 1]]),
        ([16, 6, 7], 17, [1, 5], [[1, 1], [0, 2]]),
        ([16, 6, 7], 17, [5, 1], [[1, 1], [2, 0]]),
    ]
    .into_iter()
    .enumerate()
    {
        let [channels, height, width] = input;
        let input = [2, channels, height, width];
        let weight = [outputs, channels, kernel[0], kernel[1]];
        check_conv2d(&number.to_string(), input, weight, options, Activation::Gelu, true);
    }
}

/// FlowNet's, and one of uneven stride.
#[test]
fn transposed_convolutions() {
    for (number, (input, outputs, kernel, [stride, padding])) in [
        ([3, 4, 5], 2, [4, 4], [[2, 2], [1, 1]]),
        ([16, 3, 9], 17, [4, 4], [[2, 2], [1, 1]]),
        ([2, 4, 3], 3, [3, 5], [[3, 2], [0, 2]]),
    ]
    .into_iter()
    .enumerate()
    {
        let [channels, height, width] = input;
        let shapes = [
            ("input", [2, channels, height, width]),
            ("weight", [channels, outputs, kernel[0], kernel[1]]),
            ("bias", [outputs, 1, 1, 1]),
        ];
        check(&format!("conv_transpose2d {number}"), &shapes, |inputs| {
            let [input, weight, bias] = <[Tensor<4>; 3]>::try_from(inputs).expect("three");
            let options = Conv2dOptions::new(stride, padding);
            conv_transpose2d(input, weight, Some(bias.flatten(0, 3)), Activation::LeakyRelu, options)
        });
    }
}

#[test]
fn depthwise_convolutions_of_every_kind() {
    for (number, (kernel, padding)) in
        [([5, 3], [1, 0]), ([7, 7], [3, 3]), ([15, 15], [7, 7])].into_iter().enumerate()
    {
        check_depthwise(&number.to_string(), [2, 3, 17, 19], kernel, padding, Activation::Gelu, true);
    }
}

/// RAFT's and RAFT-S's. The positions have no gradient: the networks detach them.
#[test]
fn correlation_lookup() {
    for (levels, radius) in [(4, 4), (4, 3)] {
        let case = format!("lookup {levels} {radius}");
        check_every(7, &case, &[("first", [1, 4, 16, 17]), ("second", [1, 4, 16, 17])], |inputs| {
            let [first, second] = inputs.try_into().expect("two");
            let coords = made_up(&case, "coords", [1, 2, 16, 17], &first.device());
            Correlation::new(first, second, levels).windows(coords, radius)
        });
    }
}

#[test]
fn warping() {
    check("warp", &[("image", [2, 3, 5, 6]), ("displacement", [2, 2, 5, 6])], |inputs| {
        let [image, flow] = inputs.try_into().expect("two");
        warp(image, flow)
    });
}

#[test]
fn convex_upsampling() {
    check("upsample", &[("flow", [2, 2, 3, 4]), ("mask", [2, 9 * 64, 3, 4])], |inputs| {
        let [flow, mask] = inputs.try_into().expect("two");
        convex_upsample(flow, mask, 0.25, 8)
    });
}

/// GMA's scales the queries by one over the root of their channels, and adds to the values what they gather.
#[test]
fn attention_map() {
    for kept_bytes in [0, usize::MAX] {
        let shapes = [("queries", [2, 3, 4, 5]), ("keys", [2, 3, 4, 5]), ("values", [2, 2, 4, 5])];
        check("attention", &shapes, |inputs| {
            let [queries, keys, values] = inputs.try_into().expect("three");
            let attention = Attention::new(queries * (4.0 / 3.0_f32.sqrt()), keys, kept_bytes);
            attention.gather(values.clone()) + values
        });
    }
}

/// UniMatch's, which rolls and masks windows that are moved.
#[test]
fn windowed_attention() {
    let map = [2, 3, 4, 6];
    let shapes = [("queries", map), ("keys", map), ("values", map)];
    let ways = [("", Windows::split([4, 6], 2)), (" shifted", Windows::shifted([4, 6], 2))];
    for (way, windows) in ways {
        check(&format!("windowed attention{way}"), &shapes, |inputs| {
            let [queries, keys, values] = inputs.try_into().expect("three");
            attention::tensor::attention(queries * (4.0 / 3.0_f32.sqrt()), keys, values, &windows)
        });
    }
}

/// SKFlow's: two chains of three pointwise layers, a depthwise convolution of 15x15 between them.
#[test]
fn skflow_block() {
    let (wide, bias) = (9, |channels| [channels, 1, 1, 1]);
    let shapes = [
        ("input", [2, 6, 8, 9]),
        ("ffn1.0.weight", [wide, 6, 1, 1]),
        ("ffn1.0.bias", bias(wide)),
        ("ffn1.2.weight", [6, wide, 1, 1]),
        ("ffn1.2.bias", bias(6)),
        ("conv_list.0.weight", [6, 1, 1, 1]),
        ("conv_list.0.bias", bias(6)),
        ("conv_list.1.weight", [6, 1, 15, 15]),
        ("conv_list.1.bias", bias(6)),
        ("pw.weight", [6, 6, 1, 1]),
        ("pw.bias", bias(6)),
        ("ffn2.0.weight", [wide, 6, 1, 1]),
        ("ffn2.0.bias", bias(wide)),
        ("ffn2.2.weight", [4, wide, 1, 1]),
        ("ffn2.2.bias", bias(4)),
    ];
    check("skflow block", &shapes, |inputs| {
        let mut inputs = inputs.into_iter();
        let mut next = || inputs.next().expect("an input for each name");
        let input = next();
        let mut layer = |scale, add_input_of, activation| PointwiseLayer {
            weight: next(),
            bias: next().flatten(0, 3),
            options: LayerOptions { scale, add_input_of, activation, ..LayerOptions::default() },
        };
        let first = [
            layer(false, None, Activation::Gelu),
            layer(false, Some(0), Activation::Gelu),
            layer(true, Some(2), Activation::Gelu),
        ];
        let between = layer(true, None, Activation::Gelu);
        let last = [
            layer(false, Some(0), Activation::Gelu),
            layer(false, None, Activation::Gelu),
            layer(false, None, Activation::Identity),
        ];
        let x = pointwise_layers(input, first);
        let epilogue = Epilogue::with(Activation::Gelu).bias(Some(between.bias)).residual(x.clone());
        pointwise_layers(depthwise(x, between.weight, epilogue, [7, 7]), last)
    });
}

/// Update gates before reset gates.
#[test]
fn gated_recurrent_unit() {
    let (gates, hidden) = (("gates", [2, 6, 4, 5]), ("hidden", [2, 3, 4, 5]));
    check("gru reset", &[gates, hidden], |inputs| {
        let [gates, hidden] = inputs.try_into().expect("two");
        gru::tensor::reset(gates, hidden)
    });
    check("gru update", &[gates, hidden, ("candidate", [2, 3, 4, 5])], |inputs| {
        let [gates, hidden, candidate] = inputs.try_into().expect("three");
        gru::tensor::update(gates, hidden, candidate)
    });
}

#[test]
fn normalization_of_instances() {
    for (name, activation) in ACTIVATIONS {
        check(&format!("instance norm {name}"), &[("input", [2, 3, 5, 6])], |inputs| {
            let [input] = inputs.try_into().expect("one");
            instance_norm(input, activation)
        });
    }
}

/// Those of RPKNet.
#[test]
fn normalization_of_groups_and_layers() {
    let shapes = [("input", [2, 6, 5, 7])];
    for (name, activation) in ACTIVATIONS {
        check(&format!("group norm {name}"), &shapes, |inputs| {
            let [input] = inputs.try_into().expect("one");
            group_norm(input, 3, 1e-6, activation)
        });
        check(&format!("layer norm {name}"), &shapes, |inputs| {
            let [input] = inputs.try_into().expect("one");
            layer_norm(input, 1e-6, activation)
        });
    }
}

#[test]
fn normalization_of_batches() {
    let shapes = [("input", [4, 3, 5, 6]), ("weight", [3, 1, 1, 1]), ("bias", [3, 1, 1, 1])];
    for (name, relu) in [("identity", false), ("relu", true)] {
        check(&format!("batch norm {name}"), &shapes, |inputs| {
            let [input, weight, bias] = <[Tensor<4>; 3]>::try_from(inputs).expect("three");
            batch_norm(input, weight.flatten(0, 3), bias.flatten(0, 3), relu).output
        });
    }
}
