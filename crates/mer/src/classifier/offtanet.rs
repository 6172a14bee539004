//! Off-TANet (Zhang et al., PRICAI 2021): two residual blocks, then a block with channel, spatial and self-attention, the
//! "triplet attention". Reference: `models/off_tanet.py` of ECNU-Cross-Innovation-Lab/PRICAI2021-Off-TANet, `net_type`
//! `ta`. Parity: `PARITY.md`.

use burn::module::Module;
use burn::tensor::activation::{relu, sigmoid, softmax};
use burn::tensor::module::adaptive_avg_pool2d;
use burn::tensor::{Device, Tensor, TensorData};
use srflow_core::random::Stream;
use srflow_nn::layers::{BatchNorm, Conv2d, Conv2dConfig, Linear, LinearConfig, NoParameters, dropout};
use srflow_ops::Activation;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::max_pool::tensor::max_pool;

use super::{Classifier, ClassifierFacts};
use crate::features::{FEATURE_SIDE, Features};

/// Channels of the attention block.
const CHANNELS: usize = 28;
/// Heads of its self-attention.
const HEADS: usize = 4;
/// Height and width of its maps.
const SIDE: usize = 14;

#[derive(Module, Debug)]
pub struct OffTaNet {
    conv1: (Conv2d, NoParameters, BatchNorm),
    res1: Residual,
    res2: Residual,
    eres: EnhancedResidual,
    dense: (Linear, NoParameters, NoParameters, Linear, NoParameters, NoParameters, Linear),
}

#[derive(Module, Debug)]
struct Residual {
    conv: (Conv2d, BatchNorm, NoParameters, Conv2d, BatchNorm),
    botneck: Conv2d,
}

#[derive(Module, Debug)]
struct EnhancedResidual {
    conv1: (Conv2d, BatchNorm),
    conv2: (Conv2d, BatchNorm),
    botneck: Conv2d,
    spa: SpatialAttention,
    ca: ChannelAttention,
    sa: MultiHeadSelfAttention,
}

#[derive(Module, Debug)]
struct SpatialAttention {
    conv1: Conv2d,
}

#[derive(Module, Debug)]
struct ChannelAttention {
    fc1: Conv2d,
    fc2: Conv2d,
}

#[derive(Module, Debug)]
struct MultiHeadSelfAttention {
    sa_blocks: Vec<SelfAttention>,
}

#[derive(Module, Debug)]
struct SelfAttention {
    w_q: Conv2d,
    w_k: Conv2d,
    w_v: Conv2d,
}

fn conv(channels: [usize; 2], kernel: usize) -> Conv2dConfig {
    Conv2dConfig::new(channels, [kernel; 2])
}

impl Classifier for OffTaNet {
    const FACTS: ClassifierFacts = ClassifierFacts {
        name: "off-tanet",
        title: "Off-TANet",
        paper: "Zhang et al., PRICAI 2021",
        reference: "https://github.com/ECNU-Cross-Innovation-Lab/PRICAI2021-Off-TANet",
        parameters: 59_403,
        input: "u, v and strain at 112x112",
    };
    const INPUT: [usize; 3] = [3, FEATURE_SIDE, FEATURE_SIDE];

    fn new(device: &Device, classes: usize) -> Self {
        let linear = |inputs, outputs| LinearConfig::new(inputs, outputs).init(device);
        Self {
            conv1: (conv([3, 8], 7).with_stride(2).init(device), NoParameters, BatchNorm::new(8, device)),
            res1: Residual::new(8, 18, device),
            res2: Residual::new(18, CHANNELS, device),
            eres: EnhancedResidual::new(device),
            dense: (
                linear(8 * 7 * 7, 64),
                NoParameters,
                NoParameters,
                linear(64, 64),
                NoParameters,
                NoParameters,
                linear(64, classes),
            ),
        }
    }

    fn input(features: &Features) -> Vec<f32> {
        features.values().to_vec()
    }

    fn scores(&self, inputs: Tensor<4>, mut random: Option<&mut Stream>) -> Tensor<2> {
        let x = self.conv1.0.forward(inputs, Activation::Relu);
        let x = self.conv1.2.forward(x);
        let x = self.res1.forward(x);
        let x = self.res2.forward(x);
        let x = self.eres.forward(x).flatten(1, 3);
        let x = dropout(relu(self.dense.0.forward(x)), random.as_deref_mut());
        let x = dropout(relu(self.dense.3.forward(x)), random);
        self.dense.6.forward(x)
    }
}

impl Residual {
    fn new(inputs: usize, outputs: usize, device: &Device) -> Self {
        Self {
            conv: (
                conv([inputs, outputs], 3).init(device),
                BatchNorm::new(outputs, device),
                NoParameters,
                conv([outputs, outputs], 3).init(device),
                BatchNorm::new(outputs, device),
            ),
            botneck: conv([inputs, outputs], 1).init(device),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let shortcut = self.botneck.forward(x.clone(), Activation::Identity);
        let x = self.conv.1.relu_after(&self.conv.0, x);
        let x = self.conv.4.relu_after(&self.conv.3, x);
        max_pool(shortcut + x)
    }
}

impl EnhancedResidual {
    fn new(device: &Device) -> Self {
        let head = |_| {
            let [w_q, w_k, w_v] = std::array::from_fn(|_| conv([CHANNELS, CHANNELS / HEADS], 1).init(device));
            SelfAttention { w_q, w_k, w_v }
        };
        Self {
            conv1: (conv([CHANNELS, CHANNELS], 3).init(device), BatchNorm::new(CHANNELS, device)),
            conv2: (conv([CHANNELS, 8], 3).init(device), BatchNorm::new(8, device)),
            botneck: conv([CHANNELS, 8], 1).init(device),
            spa: SpatialAttention { conv1: conv([2, 1], 3).with_bias(false).init(device) },
            ca: ChannelAttention {
                fc1: conv([CHANNELS, 1], 1).with_bias(false).init(device),
                fc2: conv([1, CHANNELS], 1).with_bias(false).init(device),
            },
            sa: MultiHeadSelfAttention { sa_blocks: (0..HEADS).map(head).collect() },
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let shortcut = self.botneck.forward(x.clone(), Activation::Identity);
        let x = self.conv1.1.relu_after(&self.conv1.0, x);
        let x = self.ca.forward(x.clone()) * x;
        let x = self.spa.forward(x.clone()) * x;
        let x = self.sa.forward(x);
        let x = self.conv2.1.relu_after(&self.conv2.0, x);
        max_pool(x + shortcut)
    }
}

impl ChannelAttention {
    /// A weight for each channel, `[batch, channels, 1, 1]`.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let through = |x| self.fc2.forward(self.fc1.forward(x, Activation::Relu), Activation::Identity);
        let mean = adaptive_avg_pool2d(x.clone(), [1, 1]);
        let largest = x.max_dim(2).max_dim(3);
        sigmoid(through(mean) + through(largest))
    }
}

impl SpatialAttention {
    /// A weight for each pixel, `[batch, 1, height, width]`.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let maps = Tensor::cat(vec![x.clone().mean_dim(1), x.max_dim(1)], 1);
        self.conv1.forward(maps, Activation::Sigmoid)
    }
}

impl MultiHeadSelfAttention {
    /// Each channel of `q` times the transposed channel of `k` with the code of positions added, softmax over the whole
    /// map, times `v` pixel by pixel.
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let device = x.device();
        // One convolution for all heads: queries of every head, then keys, then values.
        let parts: [fn(&SelfAttention) -> &Conv2d; 3] =
            [|head| &head.w_q, |head| &head.w_k, |head| &head.w_v];
        let convs = || parts.iter().flat_map(|part| self.sa_blocks.iter().map(part));
        let weight = Tensor::cat(convs().map(Conv2d::weight).collect(), 0);
        let bias = Tensor::cat(convs().filter_map(Conv2d::bias).collect(), 0);
        let epilogue = Epilogue::with(Activation::Identity).bias(Some(bias));
        let all = conv2d(x, weight, epilogue, Conv2dOptions::new([1; 2], [0; 2]));
        let [batch, channels, height, width] = all.dims();
        let mut parts = all.chunk(3, 1).into_iter();
        let (Some(q), Some(k), Some(v)) = (parts.next(), parts.next(), parts.next()) else {
            unreachable!("three chunks of {channels} channels")
        };
        // q k^T + q p^T = q (k + p)^T.
        let positions = Tensor::<2>::from_data(position_code(), &device).unsqueeze();
        let attention = q.matmul((k + positions).swap_dims(2, 3));
        let attention = softmax(attention.reshape([batch, channels / 3, height * width]), 2);
        attention.reshape([batch, channels / 3, height, width]) * v
    }
}

/// `p_i + p_j` for row `i` and column `j`: `p` is the sine of `10000^-(i/2 / side)` at even `i`, the cosine at odd.
fn position_code() -> TensorData {
    let code = |i: usize| {
        let angle = 1.0 / 10_000.0_f64.powf((i / 2) as f64 / SIDE as f64);
        (if i.is_multiple_of(2) { angle.sin() } else { angle.cos() }) as f32
    };
    let values: Vec<f32> = (0..SIDE * SIDE).map(|i| code(i % SIDE) + code(i / SIDE)).collect();
    TensorData::new(values, [SIDE, SIDE])
}
