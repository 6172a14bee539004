use burn::tensor::Tensor;
use srflow_simd::{Packed, Precision};

use super::*;
use crate::operation::tests::Case;
use crate::test_values::{assert_close, values, wide, with_threads};

const PIXELS: usize = 131;

/// Dense, dense with a residual over both, a scale with a residual of its own input.
fn layers(seed: u32) -> Vec<reference::Layer> {
    let dense = |outputs: usize, inputs: usize, seed: u32| {
        let fan_in = (inputs as f32).sqrt();
        let weights: Vec<f32> = values(outputs * inputs, seed).into_iter().map(|w| w / fan_in).collect();
        reference::Map::Dense(wide(&weights))
    };
    let bias = |channels, seed| wide(&values(channels, seed));
    vec![
        reference::Layer {
            map: dense(29, 19, seed),
            bias: bias(29, seed + 1),
            add_input_of: None,
            activation: Activation::Gelu,
        },
        reference::Layer {
            map: dense(19, 29, seed + 2),
            bias: bias(19, seed + 3),
            add_input_of: Some(0),
            activation: Activation::Tanh,
        },
        reference::Layer {
            map: reference::Map::Scale(bias(19, seed + 4)),
            bias: bias(19, seed + 5),
            add_input_of: Some(2),
            activation: Activation::Relu,
        },
    ]
}

fn run(
    isa: Isa,
    precision: Precision,
    input: &[f32],
    layers: &[reference::Layer],
    planes: Option<&[f32]>,
) -> Vec<f32> {
    let narrow = |values: &[f64]| -> Vec<f32> { values.iter().map(|&x| x as f32).collect() };
    let mut inputs = 19;
    let mut operands = Vec::new();
    for layer in layers {
        let weights = match &layer.map {
            reference::Map::Dense(matrix) => Packed::rows(isa, precision, &narrow(matrix), inputs),
            reference::Map::Scale(factors) => Packed::of_numbers(narrow(factors)),
        };
        inputs = layer.bias.len();
        operands.push((weights, narrow(&layer.bias)));
    }
    let fast: Vec<Layer> = layers
        .iter()
        .zip(&operands)
        .enumerate()
        .map(|(i, (layer, (weights, bias)))| Layer {
            map: match layer.map {
                reference::Map::Dense(_) => Map::Dense { weights: weights.part(0), outputs: bias.len() },
                reference::Map::Scale(_) => Map::Scale(weights.numbers()),
            },
            bias: Some(bias),
            add: match (layer.add_input_of, planes) {
                (_, Some(planes)) if i + 1 == layers.len() => Add::Planes(planes),
                (None, _) => Add::Nothing,
                (Some(number), _) => Add::InputOf(number),
            },
            activation: layer.activation,
        })
        .collect();
    pointwise(isa, input, [2, 19, PIXELS], &fast)
}

/// Places of the channels of each pixel of two images.
fn pixels(channels: usize, pixels: usize) -> impl Iterator<Item = Vec<usize>> {
    let place = move |n, p| (0..channels).map(|c| (n * channels + c) * pixels + p).collect();
    (0..2).flat_map(move |n| (0..pixels).map(move |p| place(n, p)))
}

fn take(values: &[f64], places: &[usize]) -> Vec<f64> {
    places.iter().map(|&place| values[place]).collect()
}

fn put(values: &mut [f64], places: &[usize], new: &[f64]) {
    places.iter().zip(new).for_each(|(&place, &new)| values[place] = new);
}

/// The chain of the definition, on two images.
fn expected(input: &[f64], layers: &[reference::Layer], count: usize) -> Vec<f64> {
    let (inputs, outputs) = (input.len() / 2 / count, layers[layers.len() - 1].bias.len());
    let mut out = vec![0.0; 2 * outputs * count];
    for (from, to) in pixels(inputs, count).zip(pixels(outputs, count)) {
        put(&mut out, &to, &reference::pointwise(&take(input, &from), layers));
    }
    out
}

#[test]
fn each_instruction_set_computes_the_definition() {
    let input = values(2 * 19 * PIXELS, 1);
    for count in 1..=3 {
        let layers = &layers(2)[..count];
        let expected = expected(&wide(&input), layers, PIXELS);
        for isa in Isa::to_test() {
            assert_close(
                &format!("{count} layers, {isa:?}"),
                &run(isa, Precision::F32, &input, layers, None),
                &expected,
                3e-6,
            );
        }
    }
}

#[test]
fn planes_are_added_to_the_last_sums() {
    let input = values(2 * 19 * PIXELS, 7);
    let mut layers = layers(8);
    layers[2].add_input_of = None;
    layers[2].activation = Activation::Identity;
    let planes = values(2 * 19 * PIXELS, 9);
    let mut sums = expected(&wide(&input), &layers, PIXELS);
    sums.iter_mut().zip(&planes).for_each(|(sum, &plane)| *sum += f64::from(plane));
    for isa in Isa::to_test() {
        assert_close(
            &format!("{isa:?}"),
            &run(isa, Precision::F32, &input, &layers, Some(&planes)),
            &sums,
            3e-6,
        );
    }
}

#[test]
fn results_do_not_depend_on_threads() {
    let input = values(2 * 19 * PIXELS, 10);
    let layers = layers(11);
    let with = |threads| with_threads(threads, || run(Isa::best(), Precision::F32, &input, &layers, None));
    assert!(with(1) == with(3));
}

/// Whether a layer is a scale, what it adds and its activation; see [`layers`].
const OPTIONS: [(bool, Option<usize>, Activation); 3] = [
    (false, None, Activation::Gelu),
    (false, Some(0), Activation::Tanh),
    (true, Some(2), Activation::Sigmoid),
];

/// Of input, and weight and bias of each layer.
fn layers_of(x: &[Vec<f64>]) -> Vec<reference::Layer> {
    let layer = |((scale, add_input_of, activation), operands): (_, &[Vec<f64>])| {
        let (weight, bias) = (operands[0].clone(), operands[1].clone());
        let map = if scale { reference::Map::Scale(weight) } else { reference::Map::Dense(weight) };
        reference::Layer { map, bias, add_input_of, activation }
    };
    OPTIONS.into_iter().zip(x[1..].chunks(2)).map(layer).collect()
}

pub(crate) fn cases() -> Vec<Case> {
    let run = |inputs: Vec<_>| {
        let mut inputs = inputs.into_iter();
        let mut next = || inputs.next().expect("seven inputs");
        let input = Tensor::from_dispatch(next());
        let layers = OPTIONS.map(|(scale, add_input_of, activation)| tensor::PointwiseLayer {
            weight: Tensor::from_dispatch(next()),
            bias: Tensor::from_dispatch(next()),
            options: tensor::LayerOptions { scale, add_input_of, activation, ..Default::default() },
        });
        tensor::pointwise_layers(input, layers)
    };
    let backward = |x: &[Vec<f64>], grad: &[f64]| {
        let layers = layers_of(x);
        let mut gradients: Vec<Vec<f64>> = x.iter().map(|input| vec![0.0; input.len()]).collect();
        for places in pixels(3, 35) {
            let (d_pixel, d_layers) =
                reference::pointwise_backward(&take(&x[0], &places), &layers, &take(grad, &places));
            put(&mut gradients[0], &places, &d_pixel);
            let d_operands = d_layers.into_iter().flat_map(|layer| [layer.weight, layer.bias]);
            for (sums, terms) in gradients[1..].iter_mut().zip(d_operands) {
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            }
        }
        gradients
    };
    let shapes: [&[usize]; 7] =
        [&[2, 3, 5, 7], &[4, 3, 1, 1], &[4], &[3, 4, 1, 1], &[3], &[3, 1, 1, 1], &[3]];
    vec![Case::new("chain", &shapes, run, |x| expected(&x[0], &layers_of(x), 35), backward)]
}
