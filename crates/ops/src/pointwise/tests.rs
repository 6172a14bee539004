use burn::tensor::Tensor;
use srflow_simd::pack_rows;

use super::*;
use crate::operation::tests::Case;
use crate::test_values::{assert_close, values};

const PIXELS: usize = 131;

/// Dense, dense with a residual over both, a scale with a residual of its own input.
fn layers(seed: u32) -> Vec<reference::Layer> {
    let dense = |outputs: usize, inputs: usize, seed: u32| {
        let fan_in = (inputs as f32).sqrt();
        reference::Map::Dense(values(outputs * inputs, seed).into_iter().map(|w| w / fan_in).collect())
    };
    vec![
        reference::Layer {
            map: dense(29, 19, seed),
            bias: values(29, seed + 1),
            add_input_of: None,
            activation: Activation::Gelu,
        },
        reference::Layer {
            map: dense(19, 29, seed + 2),
            bias: values(19, seed + 3),
            add_input_of: Some(0),
            activation: Activation::Tanh,
        },
        reference::Layer {
            map: reference::Map::Scale(values(19, seed + 4)),
            bias: values(19, seed + 5),
            add_input_of: Some(2),
            activation: Activation::Relu,
        },
    ]
}

fn run(isa: Isa, input: &[f32], layers: &[reference::Layer], planes: Option<&[f32]>) -> Vec<f32> {
    let mut inputs = 19;
    let mut packed = Vec::new();
    for layer in layers {
        let mut weights = match &layer.map {
            reference::Map::Dense(weights) | reference::Map::Scale(weights) => weights.clone(),
        };
        if let reference::Map::Dense(matrix) = &layer.map {
            pack_rows(isa, matrix, inputs, &mut weights);
        }
        inputs = layer.bias.len();
        packed.push(weights);
    }
    let fast: Vec<Layer> = layers
        .iter()
        .zip(&packed)
        .enumerate()
        .map(|(i, (layer, packed))| Layer {
            map: match layer.map {
                reference::Map::Dense(_) => Map::Dense(packed),
                reference::Map::Scale(_) => Map::Scale(packed),
            },
            bias: Some(&layer.bias),
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

/// The chain of the definition.
fn expected(input: &[f32], layers: &[reference::Layer]) -> Vec<f32> {
    let outputs = layers[layers.len() - 1].bias.len();
    let mut out = vec![0.0; 2 * outputs * PIXELS];
    for (n, p) in (0..2).flat_map(|n| (0..PIXELS).map(move |p| (n, p))) {
        let pixel: Vec<f32> = (0..19).map(|c| input[(n * 19 + c) * PIXELS + p]).collect();
        for (o, value) in reference::pointwise(&pixel, layers).into_iter().enumerate() {
            out[(n * outputs + o) * PIXELS + p] = value;
        }
    }
    out
}

#[test]
fn each_instruction_set_computes_the_definition() {
    let input = values(2 * 19 * PIXELS, 1);
    for count in 1..=3 {
        let layers = &layers(2)[..count];
        let expected = expected(&input, layers);
        for isa in Isa::to_test() {
            assert_close(
                &format!("{count} layers, {isa:?}"),
                &run(isa, &input, layers, None),
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
    let mut sums = expected(&input, &layers);
    sums.iter_mut().zip(&planes).for_each(|(sum, plane)| *sum += plane);
    for isa in Isa::to_test() {
        assert_close(&format!("{isa:?}"), &run(isa, &input, &layers, Some(&planes)), &sums, 3e-6);
    }
}

#[test]
fn results_do_not_depend_on_threads() {
    let input = values(2 * 19 * PIXELS, 10);
    let layers = layers(11);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
        pool.install(|| run(Isa::best(), &input, &layers, None))
    };
    assert!(with(1) == with(3));
}

/// Two images of five by six pixels; see [`layers`].
pub(crate) fn cases() -> Vec<Case> {
    const OPTIONS: [(bool, Option<usize>, Activation); 3] = [
        (false, None, Activation::Gelu),
        (false, Some(0), Activation::Tanh),
        (true, Some(2), Activation::Sigmoid),
    ];
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
    let definition = |x: &[Vec<f32>]| {
        let layer = |number: usize| {
            let (scale, add_input_of, activation) = OPTIONS[number];
            let (weight, bias) = (x[1 + 2 * number].clone(), x[2 + 2 * number].clone());
            let map = if scale { reference::Map::Scale(weight) } else { reference::Map::Dense(weight) };
            reference::Layer { map, bias, add_input_of, activation }
        };
        let layers = [0, 1, 2].map(layer);
        let mut out = vec![0.0; 2 * 3 * 30];
        for (n, p) in (0..2).flat_map(|n| (0..30).map(move |p| (n, p))) {
            let pixel: Vec<f32> = (0..3).map(|c| x[0][(n * 3 + c) * 30 + p]).collect();
            for (c, value) in reference::pointwise(&pixel, &layers).into_iter().enumerate() {
                out[(n * 3 + c) * 30 + p] = value;
            }
        }
        out
    };
    let shapes: [&[usize]; 7] =
        [&[2, 3, 5, 6], &[4, 3, 1, 1], &[4], &[3, 4, 1, 1], &[3], &[3, 1, 1, 1], &[3]];
    vec![Case::new("chain", &shapes, run, definition)]
}
