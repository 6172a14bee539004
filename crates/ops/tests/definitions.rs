//! Every operation on tensors against its definition, with sizes as the networks have them and flows that leave the image.
//! `SRFLOW_TEST_DEVICE` names the device; see docs/devices.md.

use std::sync::LazyLock;

use burn::tensor::{Device, Tensor, TensorData};
use srflow_ops::Activation;
use srflow_ops::attention;
use srflow_ops::attention::tensor::Attention;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::conv2d::{self, Conv2dShape};
use srflow_ops::correlation;
use srflow_ops::correlation::tensor::Correlation;
use srflow_ops::depthwise::tensor::depthwise;
use srflow_ops::depthwise::{self, DepthwiseShape};
use srflow_ops::instance_norm;
use srflow_ops::upsample::tensor::convex_upsample;
use srflow_ops::upsample::{self, UpsampleShape};
use srflow_ops::warp::tensor::warp;
use srflow_ops::warp::{self, WarpShape};

/// Values in -1..1 that repeat nowhere near.
fn values(count: usize, seed: u32) -> Vec<f32> {
    (0..count as u32)
        .map(|i| {
            let bits = (i ^ (seed << 20)).wrapping_mul(0x9E37_79B9).rotate_left(13).wrapping_mul(0x85EB_CA6B);
            (bits >> 8) as f32 / 8_388_608.0 - 1.0
        })
        .collect()
}

/// Found once: to ask drivers for their devices takes time.
static DEVICE: LazyLock<Device> = LazyLock::new(|| {
    let name = std::env::var("SRFLOW_TEST_DEVICE");
    srflow_ops::device(name.as_deref().unwrap_or("cpu")).expect("the device of SRFLOW_TEST_DEVICE")
});

fn tensor<const D: usize>(values: &[f32], shape: [usize; D]) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), &*DEVICE)
}

fn assert_close(what: &str, found: Tensor<4>, expected: &[f32]) {
    let found: Vec<f32> = found.into_data().try_to_vec().expect("f32");
    assert_eq!(found.len(), expected.len(), "{what}");
    let size = expected.iter().fold(0.0_f32, |size, x| size.max(x.abs()));
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    println!("{what}: largest difference {worst:.1e} beside {size:.1e}");
    assert!(size > 0.1 && worst < 2e-5 * size.max(1.0), "{what}: {worst} beside {size}");
}

#[test]
fn correlation_windows() {
    // As many channels, levels and entries as RAFT has; odd sizes, so that pooling leaves rows and columns out.
    let shape @ [batch, channels, height, width] = [2, 256, 9, 13];
    let (levels, radius) = (4, 4);
    let (first, second) = (values(batch * channels * 117, 1), values(batch * channels * 117, 2));
    let mut coords: Vec<f32> = values(batch * 2 * 117, 3).iter().map(|x| 6.0 + x * 12.0).collect();
    (coords[7], coords[20], coords[130]) = (1e9, -3e38, 5.0);
    let expected =
        correlation::reference::correlation_lookup(&first, &second, &coords, shape, levels, radius);
    let found = Correlation::new(tensor(&first, shape), tensor(&second, shape), levels)
        .windows(tensor(&coords, [batch, 2, height, width]), radius);
    assert_close("correlation windows", found, &expected);
}

#[test]
fn warped_images() {
    let shape = WarpShape { batch: 2, channels: 5, size: [17, 23] };
    let image = values(shape.image_len(), 1);
    let mut flow: Vec<f32> = values(shape.flow_len(), 2).iter().map(|x| x * 12.0).collect();
    (flow[3], flow[400], flow[700]) = (1e9, -3e38, 2.0);
    let found = warp(tensor(&image, [2, 5, 17, 23]), tensor(&flow, [2, 2, 17, 23]));
    assert_close("warp", found, &warp::reference::warp(&image, &flow, &shape));
}

#[test]
fn dense_convolution() {
    let shape = Conv2dShape {
        batch: 2,
        in_channels: 19,
        out_channels: 24,
        input: [11, 14],
        kernel: [3, 3],
        stride: [2, 2],
        padding: [1, 1],
    };
    let [input, weight, bias, residual] =
        [shape.input_len(), shape.weight_len(), 24, shape.output_len()].map(|len| values(len, len as u32));
    let epilogue =
        conv2d::Epilogue { bias: Some(&bias), residual: Some(&residual), activation: Activation::Gelu };
    let expected = conv2d::reference::conv2d(&input, &weight, &epilogue, &shape);
    let [height, width] = shape.output();
    let epilogue = Epilogue::with(Activation::Gelu)
        .bias(Some(tensor(&bias, [24])))
        .residual(tensor(&residual, [2, 24, height, width]));
    let options = Conv2dOptions::new(shape.stride, shape.padding);
    let found = conv2d(tensor(&input, [2, 19, 11, 14]), tensor(&weight, [24, 19, 3, 3]), epilogue, options);
    assert_close("convolution", found, &expected);
}

#[test]
fn large_depthwise_convolution() {
    let shape = DepthwiseShape { batch: 2, channels: 6, input: [12, 19], kernel: [15, 15], padding: [7, 7] };
    let (input, weight) = (values(shape.input_len(), 1), values(shape.weight_len(), 2));
    let bias = values(6, 3);
    let epilogue = conv2d::Epilogue { bias: Some(&bias), residual: None, activation: Activation::Sigmoid };
    let expected = depthwise::reference::depthwise(&input, &weight, &epilogue, &shape);
    let epilogue = Epilogue::with(Activation::Sigmoid).bias(Some(tensor(&bias, [6])));
    let found = depthwise(tensor(&input, [2, 6, 12, 19]), tensor(&weight, [6, 1, 15, 15]), epilogue, [7, 7]);
    assert_close("depthwise convolution", found, &expected);
}

#[test]
fn instance_normalization() {
    let input: Vec<f32> = values(2 * 3 * 99, 1).iter().map(|x| 3.0 + x).collect();
    let expected = instance_norm::reference::instance_norm(&input, 99, Activation::Relu);
    let found = instance_norm::tensor::instance_norm(tensor(&input, [2, 3, 9, 11]), Activation::Relu);
    assert_close("instance norm", found, &expected);
}

#[test]
fn convex_upsampling() {
    let shape = UpsampleShape { batch: 2, coarse: [5, 7], factor: 8 };
    let (flow, mask) = (values(shape.flow_len(), 1), values(shape.mask_len(), 2));
    let expected = upsample::reference::convex_upsample(&flow, &mask, 2.0, &shape);
    let found = convex_upsample(tensor(&flow, [2, 2, 5, 7]), tensor(&mask, [2, 576, 5, 7]), 2.0, 8);
    assert_close("convex upsampling", found, &expected);
}

/// So many pixels that a matrix of all pairs is cut into pieces, where there is one.
#[test]
fn attention_to_many_pixels() {
    let (shape @ [_, _, height, width], pixels) = ([1, 3, 64, 65], 64 * 65);
    let [queries, keys] =
        [1, 2].map(|seed| -> Vec<f32> { values(3 * pixels, seed).iter().map(|x| 3.0 * x).collect() });
    let sought = values(2 * pixels, 3);
    let expected = attention::reference::attention(&queries, &keys, &sought, pixels);
    for device in [DEVICE.clone(), DEVICE.clone().autodiff()] {
        let tensor =
            |values: &[f32], shape| Tensor::from_data(TensorData::new(values.to_vec(), shape), &device);
        let attention = Attention::new(tensor(&queries, shape), tensor(&keys, shape), 0);
        let found = attention.gather(tensor(&sought, [1, 2, height, width]));
        assert_close(if device.is_autodiff() { "attention, tracked" } else { "attention" }, found, &expected);
    }
}
