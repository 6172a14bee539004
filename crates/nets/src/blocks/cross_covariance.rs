//! Cross-covariance attention of XCiT (El-Nouby et al., NeurIPS 2021: <https://arxiv.org/abs/2106.09681>) as used in CCMR
//! (`xcit.py`): channels attend to channels, so memory and time are linear in the number of pixels.

use burn::module::{Module, Param};
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor, TensorData};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig, GroupNorm, LayerNorm, Linear, LinearConfig};
use srflow_ops::Activation::{Gelu, Identity};
use srflow_ops::WeightCache;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::layer_norm::tensor::layer_norm;

use super::Strips;

/// Attention heads, and groups of the norm between the depthwise convolutions.
const HEADS: usize = 8;
/// Sines and cosines per coordinate.
const WAVES: usize = 32;
/// Ratio of the longest to the shortest wavelength.
const TEMPERATURE: f32 = 10_000.0;
/// Added to the variance by layer norms.
const EPSILON: f64 = 1e-6;
/// Smallest norm by which queries and keys are divided.
const SMALLEST_NORM: f32 = 1e-12;

/// `XCiT` with one block: adds a positional encoding to a map, and computes attention weights between channels from it.
#[derive(Module, Debug)]
pub(crate) struct CrossCovariance {
    blocks: [Block; 1],
    pos_embeder: Positions,
}

/// `XCABlock`: attention, local patch interaction and an MLP, all residual.
#[derive(Module, Debug)]
struct Block {
    norm1: LayerNorm,
    attn: Attention,
    gamma1: Param<Tensor<1>>,
    norm3: LayerNorm,
    local_mp: Local,
    gamma3: Param<Tensor<1>>,
    norm2: LayerNorm,
    mlp: Perceptron,
    gamma2: Param<Tensor<1>>,
}

/// The variant does not appear in the names of parameters.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // A network has at most eight of them.
enum Attention {
    OfItself(SelfAttention),
    OfValues(ValueAttention),
}

/// `XCA`.
#[derive(Module, Debug)]
struct SelfAttention {
    temperature: Param<Tensor<3>>,
    qkv: Linear,
    proj: Linear,
}

/// `XCA_separate`.
#[derive(Module, Debug)]
struct ValueAttention {
    temperature: Param<Tensor<3>>,
    to_qk: Linear,
    to_v: Linear,
    proj: Linear,
}

/// `LPI`.
#[derive(Module, Debug)]
struct Local {
    conv1: Conv2d,
    bn: GroupNorm,
    conv2: Conv2d,
}

/// `Mlp`.
#[derive(Module, Debug)]
struct Perceptron {
    fc1: Linear,
    fc2: Linear,
}

/// `PositionalEncodingFourier`.
#[derive(Module, Debug)]
struct Positions {
    token_projection: Conv2d,
}

/// A pointwise layer: weight `[outputs, inputs]` and bias `[outputs, 1]`.
#[derive(Debug, Clone)]
struct Pointwise {
    weight: Tensor<2>,
    bias: Tensor<2>,
}

/// A map with its attention weights, which do not depend on the values and can be reused.
#[derive(Debug, Clone)]
pub(crate) struct Attending {
    /// Includes the positional encoding.
    map: Tensor<4>,
    /// Maps normalized values to the residual of the map; one layer per image.
    gather: Vec<Pointwise>,
}

impl Pointwise {
    fn of(layer: &Linear) -> Self {
        let [outputs, inputs, _, _] = layer.kernel().dims();
        let weight = layer.kernel().reshape([outputs, inputs]);
        let bias = match layer.bias() {
            Some(bias) => bias.reshape([outputs, 1]),
            None => Tensor::zeros([outputs, 1], &weight.device()),
        };
        Self { weight, bias }
    }

    /// The layer of `outputs` outputs, starting with `first`.
    fn outputs(&self, first: usize, outputs: usize) -> Self {
        let of = |x: &Tensor<2>| x.clone().narrow(0, first, outputs);
        Self { weight: of(&self.weight), bias: of(&self.bias) }
    }

    /// Folds weight and bias of `norm` into the layer, which then takes values that are normalized without them.
    fn after(self, norm: &LayerNorm) -> Self {
        let [weight, bias] = norm.weight_and_bias();
        let [inputs] = weight.dims();
        let shift = self.weight.clone().matmul(bias.reshape([inputs, 1]));
        Self { weight: self.weight * weight.reshape([1, inputs]), bias: self.bias + shift }
    }

    /// Multiplies the outputs by `gamma`.
    fn times(self, gamma: &Param<Tensor<1>>) -> Self {
        let gamma = gamma.val();
        let [outputs] = gamma.dims();
        let gamma = gamma.reshape([outputs, 1]);
        Self { weight: self.weight * gamma.clone(), bias: self.bias * gamma }
    }

    /// Applies the layer to `[batch, inputs, height, width]`.
    fn apply(&self, x: Tensor<4>, epilogue: Epilogue) -> Tensor<4> {
        let [outputs, inputs] = self.weight.dims();
        let weight = self.weight.clone().reshape([outputs, inputs, 1, 1]);
        let epilogue = epilogue.bias(Some(self.bias.clone().reshape([outputs])));
        let options = Conv2dOptions { stride: [1, 1], padding: [0, 0], cache: WeightCache::default() };
        conv2d(x, weight, epilogue, options)
    }
}

impl CrossCovariance {
    /// Self-attention between the channels of a map.
    pub(crate) fn of_itself(channels: usize, device: &Device) -> Self {
        Self::new(
            channels,
            Attention::OfItself(SelfAttention {
                temperature: temperature(device),
                qkv: LinearConfig::new(channels, 3 * channels).init(device),
                proj: LinearConfig::new(channels, channels).init(device),
            }),
            device,
        )
    }

    /// Attention between the channels of separate values, with weights from the map.
    pub(crate) fn of_values(channels: usize, device: &Device) -> Self {
        Self::new(
            channels,
            Attention::OfValues(ValueAttention {
                temperature: temperature(device),
                to_qk: LinearConfig::new(channels, 2 * channels).init(device),
                to_v: LinearConfig::new(channels, channels).init(device),
                proj: LinearConfig::new(channels, channels).init(device),
            }),
            device,
        )
    }

    fn new(channels: usize, attn: Attention, device: &Device) -> Self {
        let norm = || LayerNorm::new(channels, EPSILON, device);
        let scale = || Initializer::Ones.init([channels], device);
        let depthwise = || Conv2dConfig::new([channels; 2], [3, 3]).with_depthwise(true).init(device);
        let block = Block {
            norm1: norm(),
            attn,
            gamma1: scale(),
            norm3: norm(),
            local_mp: Local {
                conv1: depthwise(),
                bn: GroupNorm::new(HEADS, channels, device),
                conv2: depthwise(),
            },
            gamma3: scale(),
            norm2: norm(),
            mlp: Perceptron {
                fc1: LinearConfig::new(channels, channels).init(device),
                fc2: LinearConfig::new(channels, channels).init(device),
            },
            gamma2: scale(),
        };
        let token_projection = Conv2dConfig::new([2 * WAVES, channels], [1, 1]).init(device);
        Self { blocks: [block], pos_embeder: Positions { token_projection } }
    }

    /// Computes the attention weights of a map `[batch, channels, height, width]`, for values of the same shape.
    pub(crate) fn attending(&self, map: Tensor<4>) -> Attending {
        let [block] = &self.blocks;
        let map = self.pos_embeder.add_to(map);
        let [queries, keys, values] = block.attn.projections().map(|layer| layer.after(&block.norm1));
        let normal = layer_norm(map.clone(), EPSILON, Identity);
        let weights = block.attn.weights(
            queries.apply(normal.clone(), Epilogue::default()),
            keys.apply(normal, Epilogue::default()),
        );
        let project = Pointwise::of(block.attn.proj());
        let gather = (0..map.dims()[0]).map(|image| {
            let weights = weights.clone().narrow(0, image * HEADS, HEADS);
            let mixed = |x: Tensor<2>| {
                let [channels, inputs] = x.dims();
                let of_heads = x.reshape([HEADS, channels / HEADS, inputs]);
                weights.clone().matmul(of_heads).reshape([channels, inputs])
            };
            let mixed = Pointwise { weight: mixed(values.weight.clone()), bias: mixed(values.bias.clone()) };
            let gather = Pointwise {
                weight: project.weight.clone().matmul(mixed.weight),
                bias: project.weight.clone().matmul(mixed.bias) + project.bias.clone(),
            };
            gather.times(&block.gamma1)
        });
        Attending { gather: gather.collect(), map }
    }

    /// Applies the block to a map with the map as values.
    pub(crate) fn forward(&self, map: Tensor<4>) -> Tensor<4> {
        let attending = self.attending(map);
        let values = attending.map.clone();
        self.gather(&attending, values)
    }

    /// Applies the block with separate `values`, which have the shape of the map.
    pub(crate) fn gather(&self, attending: &Attending, values: Tensor<4>) -> Tensor<4> {
        let norm = |y| self.blocks[0].local_mp.bn.forward(y, Identity);
        self.finish(self.before_norm(attending, values), norm)
    }

    /// What [`gather_strip`](Self::gather_strip) needs to know of the whole map.
    pub(crate) fn sums(&self, strips: Strips, attending: &Attending, values: &Tensor<4>) -> [Tensor<2>; 2] {
        let of = |[map, values]: [Tensor<4>; 2]| {
            let [_, y] = self.before_norm(&attending.part(map), values);
            y
        };
        strips.sums(&[attending.map.clone(), values.clone()], 1, of, |y| self.blocks[0].local_mp.bn.sums(y))
    }

    /// [`gather`](Self::gather) of some rows of a map of so many pixels. Two rows are wrong at either end where the map goes on.
    pub(crate) fn gather_strip(
        &self,
        attending: &Attending,
        values: Tensor<4>,
        sums: &[Tensor<2>; 2],
        pixels: usize,
    ) -> Tensor<4> {
        let count = values.dims()[1] / HEADS * pixels;
        let norm = |y| self.blocks[0].local_mp.bn.forward_by(y, sums, count);
        self.finish(self.before_norm(attending, values), norm)
    }

    /// The map with what is gathered, and what the norm between the depthwise convolutions is of.
    fn before_norm(&self, attending: &Attending, values: Tensor<4>) -> [Tensor<4>; 2] {
        let [block] = &self.blocks;
        let x = attending.add_gathered(layer_norm(values, EPSILON, Identity));
        let y = block.local_mp.conv1.forward(block.norm3.forward(x.clone()), Gelu);
        [x, y]
    }

    fn finish(&self, [x, y]: [Tensor<4>; 2], norm: impl Fn(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
        let [block] = &self.blocks;
        let x = block.local_mp.add_to(x, norm(y), &block.gamma3);

        let hidden = Pointwise::of(&block.mlp.fc1).after(&block.norm2);
        let hidden = hidden.apply(layer_norm(x.clone(), EPSILON, Identity), Epilogue::with(Gelu));
        let out = Pointwise::of(&block.mlp.fc2).times(&block.gamma2);
        out.apply(hidden, Epilogue::default().residual(x))
    }
}

impl Attending {
    pub(crate) fn map(&self) -> &Tensor<4> {
        &self.map
    }

    /// The same of some rows of the map.
    pub(crate) fn part(&self, map: Tensor<4>) -> Self {
        Self { map, gather: self.gather.clone() }
    }

    /// The map plus the attention output for normalized values.
    fn add_gathered(&self, values: Tensor<4>) -> Tensor<4> {
        if let [gather] = self.gather.as_slice() {
            return gather.apply(values, Epilogue::default().residual(self.map.clone()));
        }
        let images = self.gather.iter().enumerate().map(|(image, gather)| {
            let of_image = |x: &Tensor<4>| x.clone().narrow(0, image, 1);
            gather.apply(of_image(&values), Epilogue::default().residual(of_image(&self.map)))
        });
        Tensor::cat(images.collect(), 0)
    }
}

fn temperature(device: &Device) -> Param<Tensor<3>> {
    Initializer::Ones.init([HEADS, 1, 1], device)
}

impl Attention {
    /// Projections to queries, keys and values.
    fn projections(&self) -> [Pointwise; 3] {
        let (first, values) = match self {
            Self::OfItself(own) => (Pointwise::of(&own.qkv), None),
            Self::OfValues(other) => (Pointwise::of(&other.to_qk), Some(Pointwise::of(&other.to_v))),
        };
        let channels = first.weight.dims()[1];
        let [queries, keys] = [0, channels].map(|start| first.outputs(start, channels));
        [queries, keys, values.unwrap_or_else(|| first.outputs(2 * channels, channels))]
    }

    fn proj(&self) -> &Linear {
        match self {
            Self::OfItself(own) => &own.proj,
            Self::OfValues(other) => &other.proj,
        }
    }

    /// Attention weights between the channels of each head: `[batch * heads, channels, channels]`.
    fn weights(&self, queries: Tensor<4>, keys: Tensor<4>) -> Tensor<3> {
        let [batch, channels, height, width] = queries.dims();
        let temperature = match self {
            Self::OfItself(own) => own.temperature.val(),
            Self::OfValues(other) => other.temperature.val(),
        };
        let [queries, keys] =
            [queries, keys].map(|x| x.reshape([batch * HEADS, channels / HEADS, height * width]));
        let [first, second] = [&queries, &keys].map(|x| {
            let square = x.clone().square().sum_dim(2);
            square.sqrt().clamp_min(SMALLEST_NORM)
        });
        let products = queries.matmul(keys.transpose()) / (first.matmul(second.transpose()));
        softmax(products * temperature.repeat(&[batch, 1, 1]), 2)
    }
}

impl Local {
    /// `x + gamma * conv2(y)`, the factor multiplied into the kernel.
    fn add_to(&self, x: Tensor<4>, y: Tensor<4>, gamma: &Param<Tensor<1>>) -> Tensor<4> {
        let gamma = gamma.val();
        let [channels] = gamma.dims();
        let kernel = self.conv2.weight() * gamma.clone().reshape([channels, 1, 1, 1]);
        let epilogue = Epilogue::default().bias(self.conv2.bias().map(|bias| bias * gamma)).residual(x);
        self.conv2.apply(y, kernel, &WeightCache::default(), epilogue)
    }
}

impl Positions {
    /// Projects the encodings of rows and columns separately, since the projection of both is the sum.
    fn add_to(&self, map: Tensor<4>) -> Tensor<4> {
        let [_, _, height, width] = map.dims();
        let device = map.device();
        let project = |first: usize, of: Tensor<4>, bias| {
            let kernel = self.token_projection.weight().narrow(1, first, WAVES);
            let epilogue = Epilogue::default().bias(bias);
            self.token_projection.apply(of, kernel, &WeightCache::default(), epilogue)
        };
        let rows = Tensor::<1>::from_data(waves(height), &device).reshape([1, WAVES, height, 1]);
        let columns = Tensor::<1>::from_data(waves(width), &device).reshape([1, WAVES, 1, width]);
        let map = map + project(0, rows, self.token_projection.bias());
        map + project(WAVES, columns, None)
    }
}

/// Alternating sines and cosines of the positions along a side, `[WAVES, side]`; the side is one period of the shortest wave.
fn waves(side: usize) -> TensorData {
    let place = |at: usize| (at + 1) as f32 / (side as f32 + 1e-6) * std::f32::consts::TAU;
    let wave = |number: usize| TEMPERATURE.powf((2 * (number / 2)) as f32 / WAVES as f32);
    let of = |number: usize, at: usize| {
        let angle = place(at) / wave(number);
        if number.is_multiple_of(2) { angle.sin() } else { angle.cos() }
    };
    let numbers: Vec<f32> = (0..WAVES).flat_map(|number| (0..side).map(move |at| of(number, at))).collect();
    TensorData::new(numbers, [WAVES * side])
}
