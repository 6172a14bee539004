//! The classifiers against their published code, run in PyTorch; `tools/parity/mer_networks.py` repeats the rules for
//! parameters and inputs and wrote the golden values.

use std::path::PathBuf;

use burn::tensor::{Device, Int, Tensor, TensorData};
use srflow_mer::{
    CLASSIFIERS, Classifier, ClassifierFacts, OffApexNet, OffTaNet, SssNet, StstNet, Training, cross_entropy,
};
use srflow_nn::{
    HostGradients, Layout, Parameters, Segment, load, parameter_infos, parameters, with_batch_statistics,
    with_parameters,
};
use srflow_ops::golden::{Golden, name_hash, noise, numbers};

const LABELS: [i64; 5] = [0, 2, 1, 0, 1];
const LEARNING_RATE: f64 = 6.5e-4;
/// Biases of convolutions right before a batch norm: they have no gradient.
const NO_GRADIENT: [&str; 4] = ["conv.0.bias", "conv.3.bias", "eres.conv1.0.bias", "eres.conv2.0.bias"];

/// Weights of variance 1 / fan_in, so that activations keep their size; the rest near what training leaves.
fn parameter(name: &str, shape: &[usize]) -> Vec<f32> {
    let count: usize = shape.iter().product();
    let fan_in: usize = shape[1..].iter().product();
    let rule = |u: f32| match name.rsplit('.').next() {
        Some("running_var") => 1.0 + 0.5 * u,
        Some("weight") if shape.len() == 1 => 1.0 + 0.25 * u,
        Some("weight") => u * (3.0 / fan_in as f64).sqrt() as f32,
        _ => 0.1 * u,
    };
    (0..count as u32).map(|i| rule(noise(i, name_hash(name)))).collect()
}

fn filled<C: Classifier>(device: &Device) -> C {
    let network = C::new(device, 3);
    let fill = |info: srflow_nn::ParameterInfo| {
        let values = parameter(&info.name, &info.shape);
        (info.name, TensorData::new(values, info.shape))
    };
    let parameters: Parameters = parameter_infos(&network).into_iter().map(fill).collect();
    with_parameters(network, parameters).expect("its own names and shapes")
}

fn inputs<C: Classifier>(device: &Device) -> Tensor<4> {
    let [channels, height, width] = C::INPUT;
    let shape = [LABELS.len(), channels, height, width];
    let values: Vec<f32> = (0..shape.iter().product::<usize>() as u32).map(|i| noise(i, 7)).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn golden_path(name: &str) -> PathBuf {
    ["tests/golden", name].iter().collect()
}

fn golden<C: Classifier>() -> Golden {
    Golden::read(golden_path(&format!("{}.safetensors", C::FACTS.name)))
}

fn assert_close(golden: &Golden, name: &str, found: &[f32], tolerance: f32) {
    let expected = golden.values(name);
    assert_eq!(expected.len(), found.len(), "{name}");
    let worst = expected.iter().zip(found).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst <= tolerance, "{name}: {found:?} for {expected:?}");
}

/// Sum of squares and first value.
fn assert_digest(golden: &Golden, name: &str, values: &[f32], relative: f32) {
    let squares = values.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() as f32;
    let expected = golden.values(name);
    let typical = (expected[0] / values.len() as f32).sqrt();
    assert!(
        (squares - expected[0]).abs() <= relative * expected[0].max(1e-9)
            && (values[0] - expected[1]).abs() <= relative * typical.max(1e-5),
        "{name}: {squares}, {} for {expected:?}",
        values[0]
    );
}

fn check<C: Classifier>() {
    let golden = golden::<C>();
    let plain = Device::flex();
    let network: C = filled(&plain);
    let learned = parameter_infos(&network).into_iter().filter(|info| !info.name.contains("running_"));
    assert_eq!(learned.map(|info| info.shape.iter().product::<usize>()).sum::<usize>(), C::FACTS.parameters);
    let scores = network.scores(inputs::<C>(&plain), None);
    assert_close(&golden, "evaluation", &numbers(scores), 2e-5);

    let device = Device::flex().autodiff();
    let labels = || Tensor::<1, Int>::from_data(LABELS, &device);
    let network = with_batch_statistics(filled::<C>(&device), true);
    let scores = network.scores(inputs::<C>(&device), None);
    assert_close(&golden, "training", &numbers(scores.clone()), 2e-5);
    let loss = cross_entropy(scores, labels(), None);
    assert_close(&golden, "loss", &numbers(loss.clone()), 1e-5);
    let (layout, _) = Layout::of(&network);
    let mut gradients = HostGradients::zero(&layout);
    gradients.add(&network, &layout, &loss.backward(), 1.0);
    for (Segment { name, range, .. }, reached) in layout.segments().iter().zip(gradients.reached) {
        let gradient = &gradients.values[range.clone()];
        if NO_GRADIENT.iter().any(|bias| name.ends_with(bias)) {
            assert!(gradient.iter().all(|x| x.abs() < 1e-6), "{name}: {gradient:?}");
        } else if reached {
            assert_digest(&golden, &format!("gradient.{name}"), gradient, 1e-3);
        }
    }

    let mut training = Training::new(filled::<C>(&device));
    for step in 0..3 {
        training.step(inputs::<C>(&device), labels(), LEARNING_RATE * 0.3_f64.powi(step), None);
    }
    for (name, data) in parameters(&training.network().valid()) {
        // Where a map is positive everywhere, batch norm takes the bias away again: its gradient is rounding, which Adam makes whole steps.
        if C::FACTS.name == "sssnet" && ["conv1.bias", "conv2.bias"].contains(&name.as_str()) {
            continue;
        }
        let unit = if name.contains("running_") { 1.0 } else { LEARNING_RATE as f32 };
        let start = parameter(&name, data.shape());
        let end: Vec<f32> = data.try_to_vec().expect("f32");
        let moved: Vec<f32> = end.iter().zip(start).map(|(end, start)| (end - start) / unit).collect();
        assert_digest(&golden, &format!("stepped.{name}"), &moved, 0.02);
    }
}

#[test]
fn off_tanet() {
    check::<OffTaNet>();
}

#[test]
fn ststnet() {
    check::<StstNet>();
}

#[test]
fn sssnet() {
    check::<SssNet>();
}

#[test]
fn off_apexnet() {
    check::<OffApexNet>();
}

#[test]
fn class_weights_are_pytorchs() {
    let device = Device::flex();
    let scores: Tensor<2> =
        Tensor::from_data([[1.0_f32, 0.0, -1.0], [0.5, 2.0, 0.0], [0.0, 0.0, 3.0]], &device);
    let labels = Tensor::<1, Int>::from_data([0_i64, 2, 1], &device);
    // CrossEntropyLoss(weight=torch.tensor([0.5, 1.0, 4.0])) of PyTorch 2.11.
    let loss = numbers(cross_entropy(scores, labels, Some(&[0.5, 1.0, 4.0])));
    assert!((loss[0] - 2.277_118).abs() < 1e-6, "{loss:?}");
}

#[test]
fn a_checkpoint_in_its_published_form_loads() {
    let device = Device::flex();
    let network: StstNet = load(StstNet::new(&device, 3), &golden_path("ststnet.pth")).unwrap();
    let scores = network.scores(inputs::<StstNet>(&device), None);
    assert_close(&golden::<StstNet>(), "evaluation", &numbers(scores), 2e-5);
    let error = load(OffTaNet::new(&device, 3), &golden_path("ststnet.pth")).unwrap_err().to_string();
    assert!(error.contains("conv1.0.weight"), "{error}");
}

#[test]
fn the_page_on_parity_lists_every_classifier() {
    for ClassifierFacts { name, title, paper, reference, parameters, input } in
        CLASSIFIERS.map(|entry| entry.facts)
    {
        let row = format!("| {title} | `{name}` | {paper} | {reference} | {parameters} | {input} |");
        assert!(include_str!("../../PARITY.md").contains(&row), "{row}");
    }
}
