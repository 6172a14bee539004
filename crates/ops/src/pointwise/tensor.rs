//! A chain of pointwise layers on tensors, with gradients.

use burn::tensor::Tensor;
use srflow_simd::{Isa, Packed};

use super::{Add, Layer, Map, pointwise};
use crate::conv2d::possible;
use crate::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use crate::depthwise::tensor::depthwise;
use crate::flex::CpuTensor;
use crate::operation::array;
use crate::precision::cpu_precision;
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

/// Pointwise layers, at least one, on `input` (`[batch, channels, height, width]`), one after another; what lies between them is
/// never stored as a whole. Panics when the sizes do not fit each other.
pub fn pointwise_layers<const N: usize>(input: Tensor<4>, layers: [PointwiseLayer; N]) -> Tensor<4> {
    const { assert!(N > 0) };
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
    // The kernel has no gradients, so with them, and on other devices, the layers run one after another.
    match cpu_operands(&input, &layers) {
        Some((input, operands)) => fused(&input, &operands, layers.each_ref().map(|layer| &layer.options)),
        None => one_by_one(input, layers),
    }
}

/// The input, and weight and bias of each layer, where all are on the CPU and not part of a graph.
fn cpu_operands<const N: usize>(
    input: &Tensor<4>,
    layers: &[PointwiseLayer; N],
) -> Option<(CpuTensor, [[CpuTensor; 2]; N])> {
    let of_layer =
        |layer: &PointwiseLayer| Some([CpuTensor::of(&layer.weight)?, CpuTensor::of(&layer.bias)?]);
    let operands = layers.iter().map(of_layer).collect::<Option<Vec<_>>>()?;
    Some((CpuTensor::of(input)?, array(operands)))
}

fn fused<const N: usize>(
    input: &CpuTensor,
    operands: &[[CpuTensor; 2]; N],
    options: [&LayerOptions; N],
) -> Tensor<4> {
    let (isa, precision) = (Isa::best(), cpu_precision());
    let packing = Packing { pass: Pass::Forward, isa, precision, stride: [1, 1], padding: [0, 0] };
    let packed: [_; N] = std::array::from_fn(|i| {
        let [weight, _] = &operands[i];
        let [_, depth, _, _] = weight.dims();
        options[i].cache.get(packing, weight.tensor(), |weight| {
            if options[i].scale {
                return Packed::of_numbers(weight.to_vec());
            }
            let outputs = weight.len() / depth;
            Packed::rows(isa, possible(precision, [depth, outputs]), weight, depth)
        })
    });
    let layers: [Layer; N] = std::array::from_fn(|i| Layer {
        map: if options[i].scale {
            Map::Scale(packed[i].numbers())
        } else {
            Map::Dense { weights: packed[i].part(0), outputs: operands[i][0].dims::<4>()[0] }
        },
        bias: Some(operands[i][1].slice()),
        add: options[i].add_input_of.map_or(Add::Nothing, Add::InputOf),
        activation: options[i].activation,
    });
    let [batch, channels, height, width] = input.dims();
    let [outputs] = operands[N - 1][1].dims();
    let out = pointwise(isa, input.slice(), [batch, channels, height * width], &layers);
    CpuTensor::new(out, [batch, outputs, height, width]).into_tensor()
}

fn one_by_one<const N: usize>(input: Tensor<4>, layers: [PointwiseLayer; N]) -> Tensor<4> {
    let mut inputs = Vec::with_capacity(layers.len());
    let mut x = input;
    for PointwiseLayer { weight, bias, options } in layers {
        inputs.push(x.clone());
        let LayerOptions { scale, add_input_of, activation, cache } = options;
        let residual = add_input_of.map(|number| inputs[number].clone());
        let epilogue = Epilogue { bias: Some(bias), residual, activation };
        x = if scale {
            depthwise(x, weight, epilogue, [0, 0])
        } else {
            conv2d(x, weight, epilogue, Conv2dOptions { stride: [1, 1], padding: [0, 0], cache })
        };
    }
    x
}
