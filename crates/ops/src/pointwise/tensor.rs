//! A chain of three pointwise layers on tensors, with gradients.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, backend_extension};
use burn::tensor::Tensor;
use srflow_simd::{Isa, pack_rows};

use super::{Add, Layer, Map, pointwise};
use crate::conv2d::tensor::{Conv2dGradOps, Conv2dOps, Conv2dOptions};
use crate::depthwise::tensor::{DepthwiseGradOps, DepthwiseOps};
use crate::flex::{Contiguous, sizes, tensor};
use crate::tracked::EpilogueGradOps;
use crate::weight_cache::{Packing, Pass};
use crate::{Activation, WeightCache};

/// What a layer does beside multiplying with its weight.
#[derive(Debug, Clone, Default)]
pub struct LayerOptions {
    /// The weight is a factor for each channel, `[channels, 1, 1, 1]`, rather than `[outputs, inputs, 1, 1]`.
    pub scale: bool,
    /// Adds what went into the layer of this number (0 is the input of the chain) to the sums.
    pub add_input_of: Option<usize>,
    /// Applied last.
    pub activation: Activation,
    /// Of the weight.
    pub cache: WeightCache,
}

/// A layer: weight, bias (`[outputs]`) and options.
#[derive(Debug, Clone)]
pub struct PointwiseLayer {
    /// See [`LayerOptions::scale`].
    pub weight: Tensor<4>,
    /// A number for each output channel.
    pub bias: Tensor<1>,
    /// The rest.
    pub options: LayerOptions,
}

/// The chain. The default computes one layer after another.
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait PointwiseOps: Backend + Conv2dOps + DepthwiseOps {
    /// See [`pointwise_layers`].
    #[allow(clippy::too_many_arguments)] // tensors can only be passed one by one
    fn three_pointwise_layers(
        input: FloatTensor<Self>,
        first_weight: FloatTensor<Self>,
        first_bias: FloatTensor<Self>,
        second_weight: FloatTensor<Self>,
        second_bias: FloatTensor<Self>,
        third_weight: FloatTensor<Self>,
        third_bias: FloatTensor<Self>,
        options: [LayerOptions; 3],
    ) -> FloatTensor<Self> {
        let layers = [(first_weight, first_bias), (second_weight, second_bias), (third_weight, third_bias)];
        let mut inputs = Vec::with_capacity(layers.len());
        let mut x = input;
        for ((weight, bias), options) in layers.into_iter().zip(options) {
            inputs.push(x.clone());
            let LayerOptions { scale, add_input_of, activation, cache } = options;
            let add = add_input_of.map(|number| inputs[number].clone());
            let dense = Conv2dOptions { stride: [1, 1], padding: [0, 0], cache };
            x = match (scale, add) {
                (false, None) => Self::biased_conv2d(x, weight, bias, dense, activation),
                (false, Some(add)) => Self::residual_conv2d(x, weight, bias, add, dense, activation),
                (true, None) => Self::biased_depthwise(x, weight, bias, [0, 0], activation),
                (true, Some(add)) => Self::residual_depthwise(x, weight, bias, add, [0, 0], activation),
            };
        }
        x
    }
}

#[cfg(feature = "cube")]
impl PointwiseOps for burn_cubecl::CubeBackend {}

impl PointwiseOps for Flex {
    fn three_pointwise_layers(
        input: FloatTensor<Self>,
        first_weight: FloatTensor<Self>,
        first_bias: FloatTensor<Self>,
        second_weight: FloatTensor<Self>,
        second_bias: FloatTensor<Self>,
        third_weight: FloatTensor<Self>,
        third_bias: FloatTensor<Self>,
        options: [LayerOptions; 3],
    ) -> FloatTensor<Self> {
        let isa = Isa::best();
        let weights = [first_weight, second_weight, third_weight];
        let biases = [&first_bias, &second_bias, &third_bias].map(Contiguous::new);
        let packing = Packing { pass: Pass::Forward, isa, stride: [1, 1], padding: [0, 0] };
        let packed = [0, 1, 2].map(|i| {
            options[i].cache.get(packing, &weights[i], |weight| {
                let mut packed = vec![0.0; weight.len()];
                let depth = if options[i].scale { 1 } else { sizes::<4>(&weights[i])[1] };
                if options[i].scale {
                    packed.copy_from_slice(weight);
                } else {
                    pack_rows(isa, weight, depth, &mut packed);
                }
                packed
            })
        });
        let layers = [0, 1, 2].map(|i| Layer {
            map: if options[i].scale { Map::Scale(&packed[i]) } else { Map::Dense(&packed[i]) },
            bias: Some(biases[i].slice()),
            add: options[i].add_input_of.map_or(Add::Nothing, Add::InputOf),
            activation: options[i].activation,
        });
        let [batch, channels, height, width] = sizes(&input);
        let outputs = sizes::<4>(&weights[2])[0];
        let input = Contiguous::new(&input);
        let out = pointwise(isa, input.slice(), [batch, channels, height * width], &layers);
        tensor(out, [batch, outputs, height, width])
    }
}

impl<B, C> PointwiseOps for Autodiff<B, C>
where
    B: Conv2dOps + Conv2dGradOps + DepthwiseOps + DepthwiseGradOps + EpilogueGradOps,
    C: CheckpointStrategy,
{
}

/// Three pointwise layers on `input` (`[batch, channels, height, width]`), one after another; what lies between them is
/// never stored as a whole. Panics when the sizes do not fit each other.
pub fn pointwise_layers(input: Tensor<4>, layers: [PointwiseLayer; 3]) -> Tensor<4> {
    let mut channels = vec![input.dims()[1]];
    for (number, PointwiseLayer { weight, bias, options }) in layers.iter().enumerate() {
        let [outputs, inputs, 1, 1] = weight.dims() else {
            panic!("pointwise layer {number}: a kernel of one pixel, not {:?}", weight.dims());
        };
        let expected = if options.scale { [channels[number], 1] } else { [outputs, channels[number]] };
        assert_eq!([outputs, inputs], expected, "pointwise layer {number}: outputs and inputs of the weight");
        assert_eq!(bias.dims(), [outputs], "pointwise layer {number}: a bias for each output channel");
        if let Some(other) = options.add_input_of {
            assert!(other <= number, "pointwise layer {number}: adds the input of an earlier layer");
            assert_eq!(channels[other], outputs, "pointwise layer {number}: channels of what is added");
        }
        channels.push(outputs);
    }
    let [first, second, third] = layers;
    Tensor::from_dispatch(Dispatch::three_pointwise_layers(
        input.into_dispatch(),
        first.weight.into_dispatch(),
        first.bias.into_dispatch(),
        second.weight.into_dispatch(),
        second.bias.into_dispatch(),
        third.weight.into_dispatch(),
        third.bias.into_dispatch(),
        [first.options, second.options, third.options],
    ))
}
