//! Feature and context encoder of RAFT (`extractor.py`), which reduces the size to 1/8, and encoder of UniMatch (`backbone.py`),
//! which reduces it to 1/8 or 1/4.

use burn::module::{Module, Param};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{BatchNorm, Conv2d, Conv2dConfig, GroupNorm, NoParameters};
use srflow_ops::activation::tensor::activated_sum;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use srflow_ops::instance_norm::tensor::instance_norm;
use srflow_ops::{Activation, WeightCache};

/// Channels per group of group norms.
const GROUP: usize = 8;

/// Normalization of an encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NormKind {
    None,
    Instance,
    Batch,
    /// Group norm with 8 channels per group.
    Group,
}

/// Normalization after a convolution. The variant does not appear in the names of parameters.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // A network has some dozen of them.
pub(crate) enum Norm {
    None(NoParameters),
    Instance(NoParameters),
    Batch(BatchNorm),
    Group(GroupNorm),
}

/// Configuration of an [`Encoder`].
#[derive(Debug, Clone)]
pub(crate) struct EncoderConfig {
    /// Channels of the stem and the first layer, the second layer, the third layer.
    channels: [usize; 3],
    /// Bottleneck blocks: three convolutions, through a quarter of the channels, instead of two.
    bottleneck: bool,
    output: usize,
    norm: NormKind,
    /// Whether convolutions before a norm have a bias; those in shortcuts always do.
    bias: bool,
    /// Stride of the third layer.
    last_stride: usize,
    /// Number of output scales.
    scales: usize,
}

/// A stem and three layers of two residual blocks. The stem and the second layer halve the size, and so does the third, if there is
/// a single scale.
#[derive(Module, Debug)]
pub(crate) struct Encoder {
    conv1: Conv2d,
    norm1: Norm,
    layer1: Vec<Block>,
    layer2: Vec<Block>,
    layer3: Vec<Block>,
    conv2: Conv2d,
    trident_conv: Option<TridentConv>,
}

/// `MultiScaleTridentConv`: one kernel for all output scales, whose stride doubles from each scale to the next coarser one.
#[derive(Module, Debug)]
struct TridentConv {
    weight: Param<Tensor<4>>,
    #[module(skip)]
    scales: usize,
}

/// A residual block. For blocks that change size or channels, the reference stores the norm of the shortcut twice: as
/// `downsample.1` and as `norm3` (`norm4` in a bottleneck).
#[derive(Module, Debug)]
pub(crate) struct Block {
    conv1: Conv2d,
    norm1: Norm,
    conv2: Conv2d,
    norm2: Norm,
    conv3: Option<Conv2d>,
    norm3: Option<Norm>,
    downsample: Option<(Conv2d, Norm)>,
}

/// A convolution with the initializer of RAFT's encoders.
pub(crate) fn conv(channels: [usize; 2], kernel: usize) -> Conv2dConfig {
    Conv2dConfig::new(channels, [kernel; 2])
        .with_initializer(Initializer::KaimingNormal { gain: std::f64::consts::SQRT_2, fan_out_only: true })
}

impl EncoderConfig {
    /// `BasicEncoder`.
    pub(crate) fn basic(output: usize, norm: NormKind) -> Self {
        Self {
            channels: [64, 96, 128],
            bottleneck: false,
            output,
            norm,
            bias: true,
            last_stride: 2,
            scales: 1,
        }
    }

    /// `CNNEncoder`: 1/8 of the size for one scale; for several, the finest is 1/4.
    pub(crate) fn of_scales(output: usize, scales: usize) -> Self {
        let last_stride = if scales > 1 { 1 } else { 2 };
        Self { bias: false, last_stride, scales, ..Self::basic(output, NormKind::Instance) }
    }

    /// `SmallEncoder`.
    pub(crate) fn small(output: usize, norm: NormKind) -> Self {
        Self { channels: [32, 64, 96], bottleneck: true, ..Self::basic(output, norm) }
    }

    pub(crate) fn init(&self, device: &Device) -> Encoder {
        let [first, second, third] = self.channels;
        let layer = |inputs, outputs, stride| {
            vec![self.block([inputs, outputs], stride, device), self.block([outputs, outputs], 1, device)]
        };
        Encoder {
            conv1: conv([3, first], 7).with_stride(2).with_bias(self.bias).init(device),
            norm1: Norm::new(self.norm, first, device),
            layer1: layer(first, first, 1),
            layer2: layer(first, second, 2),
            layer3: layer(second, third, self.last_stride),
            conv2: conv([third, self.output], 1).init(device),
            trident_conv: (self.scales > 1).then(|| TridentConv::new(self.output, self.scales, device)),
        }
    }

    /// A residual block with these input and output channels.
    pub(crate) fn block(&self, [inputs, outputs]: [usize; 2], stride: usize, device: &Device) -> Block {
        let norm = |channels| Norm::new(self.norm, channels, device);
        let before_norm = |channels, kernel| conv(channels, kernel).with_bias(self.bias);
        let inner = if self.bottleneck { outputs / 4 } else { outputs };
        let (first, second) = if self.bottleneck {
            (before_norm([inputs, inner], 1), before_norm([inner, inner], 3).with_stride(stride))
        } else {
            (before_norm([inputs, inner], 3).with_stride(stride), before_norm([inner, inner], 3))
        };
        Block {
            conv1: first.init(device),
            norm1: norm(inner),
            conv2: second.init(device),
            norm2: norm(inner),
            conv3: self.bottleneck.then(|| before_norm([inner, outputs], 1).init(device)),
            norm3: self.bottleneck.then(|| norm(outputs)),
            downsample: (stride > 1 || inputs != outputs)
                .then(|| (conv([inputs, outputs], 1).with_stride(stride).init(device), norm(outputs))),
        }
    }
}

impl Norm {
    pub(crate) fn new(kind: NormKind, channels: usize, device: &Device) -> Self {
        match kind {
            NormKind::None => Self::None(NoParameters),
            NormKind::Instance => Self::Instance(NoParameters),
            NormKind::Batch => Self::Batch(BatchNorm::new(channels, device)),
            NormKind::Group => Self::Group(GroupNorm::new(channels / GROUP, channels, device)),
        }
    }

    /// `relu(norm(x))`.
    fn relu(&self, x: Tensor<4>) -> Tensor<4> {
        match self {
            Self::None(_) => relu(x),
            Self::Instance(_) => instance_norm(x, Activation::Relu),
            Self::Batch(norm) => relu(norm.forward(x)),
            Self::Group(norm) => norm.forward(x, Activation::Relu),
        }
    }

    /// `activation(norm(conv(x)))`.
    pub(crate) fn after(&self, conv: &Conv2d, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        match self {
            Self::None(_) => conv.forward(x, activation),
            Self::Instance(_) => instance_norm(conv.forward(x, Activation::Identity), activation),
            Self::Batch(norm) => norm.after(conv, x, activation),
            Self::Group(norm) => norm.forward(conv.forward(x, Activation::Identity), activation),
        }
    }
}

impl Encoder {
    /// `[batch, output, height / 8, width / 8]`, or 1/4 of the size for several scales, from `[batch, 3, height, width]`.
    pub(crate) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let mut x = self.norm1.after(&self.conv1, x, Activation::Relu);
        for block in self.layer1.iter().chain(&self.layer2).chain(&self.layer3) {
            x = block.forward(x);
        }
        self.conv2.forward(x, Activation::Identity)
    }

    /// The output at each scale, coarsest first.
    pub(crate) fn forward_scales(&self, x: Tensor<4>) -> Vec<Tensor<4>> {
        let x = self.forward(x);
        match &self.trident_conv {
            Some(conv) => conv.forward(&x),
            None => vec![x],
        }
    }
}

impl TridentConv {
    fn new(channels: usize, scales: usize, device: &Device) -> Self {
        let initializer = Initializer::KaimingUniform { gain: std::f64::consts::SQRT_2, fan_out_only: false };
        Self { weight: initializer.init([channels, channels, 3, 3], device), scales }
    }

    fn forward(&self, x: &Tensor<4>) -> Vec<Tensor<4>> {
        let of_scale = |scale: usize| {
            let options = Conv2dOptions::new([1 << scale; 2], [1, 1]);
            conv2d(x.clone(), self.weight.val(), Epilogue::default(), options)
        };
        (0..self.scales).rev().map(of_scale).collect()
    }
}

impl Block {
    /// The block without its shortcut, as in CCMR for blocks that change only the channels.
    pub(crate) fn without_shortcut(self) -> Self {
        Self { downsample: None, ..self }
    }

    /// [`forward`](Self::forward) of the channels of several maps, which are made one after the other and never put together, of a
    /// block of two convolutions [without a shortcut](Self::without_shortcut). Panics without a map.
    pub(crate) fn forward_parts(&self, parts: impl Iterator<Item = Tensor<4>>) -> Tensor<4> {
        let (mut first, mut sum) = (0, None);
        for part in parts {
            let [_, channels, _, _] = part.dims();
            let weight = self.conv1.weight().narrow(1, first, channels);
            let epilogue = match sum {
                None => Epilogue::default().bias(self.conv1.bias()),
                Some(sum) => Epilogue::default().residual(sum),
            };
            sum = Some(self.conv1.apply(part, weight, &WeightCache::default(), epilogue));
            first += channels;
        }
        let y = self.norm1.relu(sum.expect("a part"));
        self.norm2.after(&self.conv2, y, Activation::Relu)
    }

    pub(crate) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let mut y = self.norm1.after(&self.conv1, x.clone(), Activation::Relu);
        y = self.norm2.after(&self.conv2, y, Activation::Relu);
        if let (Some(conv), Some(norm)) = (&self.conv3, &self.norm3) {
            y = norm.after(conv, y, Activation::Relu);
        }
        let shortcut = match &self.downsample {
            Some((conv, norm)) => norm.after(conv, x, Activation::Identity),
            None => x,
        };
        activated_sum(shortcut, y, Activation::Relu)
    }
}
