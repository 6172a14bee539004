//! Every operation on tensors: its gradients through Burn's automatic differentiation against central differences, the
//! fused forward against the one that is taken apart for the gradients, and another device against the processor.
//! `SRFLOW_TEST_DEVICE` names the device; see docs/devices.md.

use std::sync::LazyLock;

use burn::tensor::{Device, Tensor, TensorData};
use srflow_ops::Activation;
use srflow_ops::attention::tensor::Attention;
use srflow_ops::batch_norm::tensor::batch_norm;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::correlation::tensor::Correlation;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::gru;
use srflow_ops::instance_norm::tensor::instance_norm;
use srflow_ops::pointwise::tensor::{LayerOptions, PointwiseLayer, pointwise_layers};
use srflow_ops::upsample::tensor::convex_upsample;
use srflow_ops::warp::tensor::warp;

/// Values in -1..1 that repeat nowhere near.
fn values(count: usize, seed: u32) -> Vec<f32> {
    (0..count as u32)
        .map(|i| {
            let bits = (i ^ (seed << 20)).wrapping_mul(0x9E37_79B9).rotate_left(13).wrapping_mul(0x85EB_CA6B);
            (bits >> 8) as f32 / 8_388_608.0 - 1.0
        })
        .collect()
}

fn tensor(values: &[f32], shape: [usize; 4], device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().expect("f32")
}

/// Found once: to ask drivers for their devices takes time.
static DEVICE: LazyLock<Device> = LazyLock::new(|| {
    let name = std::env::var("SRFLOW_TEST_DEVICE");
    srflow_ops::device(name.as_deref().unwrap_or("cpu")).expect("the device of SRFLOW_TEST_DEVICE")
});

/// Panics when the largest difference is not small beside the largest number.
fn assert_close(what: &str, found: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let size = expected.iter().fold(1.0_f32, |size, x| size.max(x.abs()));
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("{what}: largest difference {worst:.1e} beside {size:.1e}");
    assert!(worst < tolerance * size, "{what}: {worst} beside {size}");
}

/// Holds the gradient of `sum(g * operation(inputs))` by each input to its central difference along a random direction,
/// the operation with gradients to the one without, and both on the tested device to the processor's.
fn check(shapes: &[[usize; 4]], operation: impl Fn(Vec<Tensor<4>>) -> Tensor<4>) {
    const STEP: f32 = 1.0 / 256.0;
    let plain = DEVICE.clone();
    let processor = Device::flex();
    let inputs: Vec<Vec<f32>> =
        shapes.iter().zip(1..).map(|(s, seed)| values(s.iter().product(), seed)).collect();
    let on = |inputs: &[Vec<f32>], device: &Device| -> Vec<Tensor<4>> {
        inputs.iter().zip(shapes).map(|(values, &shape)| tensor(values, shape, device)).collect()
    };
    let out = operation(on(&inputs, &plain));
    let on_processor = operation(on(&inputs, &processor));
    assert_close("output", &numbers(out.clone()), &numbers(on_processor), 2e-5);
    let weights = values(out.dims().iter().product(), 77);
    let weighted =
        |out: Vec<f32>| -> f64 { out.iter().zip(&weights).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum() };

    let leaves_on = |device: &Device| -> Vec<Tensor<4>> {
        on(&inputs, &device.clone().autodiff()).into_iter().map(Tensor::require_grad).collect()
    };
    let loss_of = |out: Tensor<4>| {
        let weights = tensor(&weights, out.dims(), &out.device());
        (out * weights).sum()
    };
    let leaves = leaves_on(&plain);
    let tracked_out = operation(leaves.clone());
    for (fused, apart) in numbers(out.clone()).iter().zip(numbers(tracked_out.clone())) {
        assert!((fused - apart).abs() < 1e-4, "fused {fused}, taken apart {apart}");
    }
    let grads = loss_of(tracked_out).backward();
    let processor_leaves = leaves_on(&processor);
    let processor_grads = loss_of(operation(processor_leaves.clone())).backward();

    for (number, leaf) in leaves.iter().enumerate() {
        let grad = numbers(leaf.grad(&grads).expect("a gradient"));
        let expected = processor_leaves[number].grad(&processor_grads).expect("a gradient");
        assert_close(&format!("gradient of input {number}"), &grad, &numbers(expected), 2e-5);
        assert!(grad.iter().any(|x| x.abs() > 1e-3), "input {number} matters");
        let direction = values(grad.len(), 50 + number as u32);
        let along: f64 = grad.iter().zip(&direction).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        let moved = |by: f32| {
            let mut inputs = inputs.clone();
            for (x, d) in inputs[number].iter_mut().zip(&direction) {
                *x += by * d;
            }
            weighted(numbers(operation(on(&inputs, &plain))))
        };
        let expected = (moved(STEP) - moved(-STEP)) / f64::from(2.0 * STEP);
        let size = grad.iter().map(|x| f64::from(x * x)).sum::<f64>().sqrt();
        assert!(
            (along - expected).abs() < 0.01 * size,
            "input {number}: {along} for {expected} (norm {size})"
        );
    }
}

#[test]
fn convolution() {
    for (options, activation) in [
        (Conv2dOptions::new([1, 1], [1, 1]), Activation::Gelu),
        (Conv2dOptions::new([2, 2], [1, 1]), Activation::Tanh),
        (Conv2dOptions::new([1, 2], [0, 2]), Activation::Sigmoid),
        (Conv2dOptions::new([1, 1], [0, 0]), Activation::Identity),
    ] {
        check(&[[2, 3, 7, 9], [5, 3, 3, 3], [1, 1, 1, 5]], |inputs| {
            let [input, weight, bias] = inputs.try_into().expect("three");
            let epilogue = Epilogue::with(activation).bias(Some(bias.reshape([5])));
            conv2d(input, weight * 0.3, epilogue, options.clone())
        });
    }
}

#[test]
fn convolution_with_something_added() {
    check(&[[2, 3, 7, 9], [5, 3, 1, 1], [1, 1, 1, 5], [2, 5, 7, 9]], |inputs| {
        let [input, weight, bias, residual] = inputs.try_into().expect("four");
        let epilogue = Epilogue::with(Activation::Gelu).bias(Some(bias.reshape([5]))).residual(residual);
        conv2d(input, weight, epilogue, Conv2dOptions::new([1, 1], [0, 0]))
    });
}

#[test]
fn depthwise_convolution() {
    check(&[[2, 3, 7, 9], [3, 1, 5, 5], [1, 1, 1, 3]], |inputs| {
        let [input, weight, bias] = inputs.try_into().expect("three");
        let epilogue = Epilogue::with(Activation::Gelu).bias(Some(bias.reshape([3]))).residual(input.clone());
        depthwise(input, weight * 0.3, epilogue, [2, 2])
    });
}

/// Enough channels for Winograd's way.
#[test]
fn convolution_by_fewer_products() {
    for kernel in [[3, 3], [1, 5], [5, 1]] {
        check(&[[1, 16, 6, 7], [17, 16, kernel[0], kernel[1]]], |inputs| {
            let [input, weight] = inputs.try_into().expect("two");
            let options = Conv2dOptions::new([1, 1], [kernel[0] / 2, kernel[1] / 2]);
            conv2d(input, weight * 0.2, Epilogue::with(Activation::Tanh), options)
        });
    }
}

#[test]
fn pointwise_chain() {
    let shapes =
        [[2, 3, 5, 6], [4, 3, 1, 1], [1, 1, 1, 4], [3, 4, 1, 1], [1, 1, 1, 3], [3, 1, 1, 1], [1, 1, 1, 3]];
    check(&shapes, |inputs| {
        let [input, first, first_bias, second, second_bias, third, third_bias] =
            inputs.try_into().expect("seven");
        let layer = |weight: Tensor<4>, bias: Tensor<4>, scale, add_input_of, activation| PointwiseLayer {
            bias: bias.flatten(0, 3),
            options: LayerOptions { scale, add_input_of, activation, ..LayerOptions::default() },
            weight,
        };
        let layers = [
            layer(first, first_bias, false, None, Activation::Gelu),
            layer(second, second_bias, false, Some(0), Activation::Tanh),
            layer(third, third_bias, true, Some(2), Activation::Sigmoid),
        ];
        pointwise_layers(input, layers)
    });
}

#[test]
fn attention() {
    for kept_bytes in [0, usize::MAX] {
        check(&[[2, 3, 4, 5], [2, 3, 4, 5], [2, 2, 4, 5]], |inputs| {
            let [queries, keys, values] = inputs.try_into().expect("three");
            let attention = Attention::new(queries, keys, kept_bytes);
            attention.gather(values.clone()) + attention.gather(values.tanh())
        });
    }
    // Queries and keys are constants, as when the encoder is not trained.
    let [queries, keys] = [5, 6].map(|seed| values(3 * 17 * 19, seed));
    check(&[[1, 2, 17, 19]], |inputs| {
        let [values] = inputs.try_into().expect("one");
        let [queries, keys] = [&queries, &keys].map(|x| tensor(x, [1, 3, 17, 19], &values.device().inner()));
        Attention::new(queries, keys, 0).gather(values)
    });
}

/// Numbers of channels that vectors divide and that they do not; positions inside, across every border and far outside.
#[test]
fn correlation_lookup() {
    for (channels, radius, levels) in [(4, 2, 3), (3, 4, 2)] {
        let mut coords: Vec<f32> = values(2 * 2 * 6 * 7, 9).iter().map(|x| 3.0 + x * 7.0).collect();
        (coords[5], coords[60]) = (-1e9, 3e38);
        check(&[[2, channels, 6, 7], [2, channels, 6, 7]], |inputs| {
            let [first, second] = inputs.try_into().expect("two");
            let coords = tensor(&coords, [2, 2, 6, 7], &first.device());
            Correlation::new(first, second, levels).windows(coords, radius)
        });
    }
}

#[test]
fn upsampling() {
    check(&[[2, 2, 3, 4], [2, 9 * 16, 3, 4]], |inputs| {
        let [flow, mask] = inputs.try_into().expect("two");
        convex_upsample(flow, mask, 0.25, 4)
    });
}

#[test]
fn warping() {
    check(&[[2, 3, 5, 6], [2, 2, 5, 6]], |inputs| {
        let [image, flow] = inputs.try_into().expect("two");
        // Small displacements around half a pixel: no sample passes a whole one, where the derivative jumps.
        warp(image, flow * 0.4 + 1.5)
    });
}

#[test]
fn gated_recurrent_unit() {
    check(&[[2, 6, 4, 5], [2, 3, 4, 5], [2, 3, 4, 5]], |inputs| {
        let [gates, hidden, candidate] = inputs.try_into().expect("three");
        gru::tensor::update(gates.clone(), hidden.clone(), gru::tensor::reset(gates, hidden) + candidate)
    });
}

#[test]
fn normalization() {
    check(&[[2, 3, 5, 6]], |inputs| {
        let [input] = inputs.try_into().expect("one");
        instance_norm(input, Activation::Tanh)
    });
}

#[test]
fn batch_normalization() {
    check(&[[4, 3, 5, 6], [1, 3, 1, 1], [1, 3, 1, 1]], |x| {
        let [input, weight, bias] = <[Tensor<4>; 3]>::try_from(x).expect("three inputs");
        batch_norm(input, weight.reshape([3]), bias.reshape([3]), false).output
    });
}
