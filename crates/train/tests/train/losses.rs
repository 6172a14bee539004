//! Values and gradients of the losses against the paper's equations in PyTorch (`tools/parity/losses.py`), and corner cases such
//! as batches without valid pixels.

use burn::tensor::{Device, Tensor, TensorData};
use srflow_nets::LaplaceMixture;
use srflow_ops::golden::{Golden, numbers};
use srflow_train::loss::{
    Border, LossConfig, LossError, LossInputs, MaskReading, Prediction, REGULARIZERS, SEQUENCE_LOSSES,
    SequenceLoss, losses,
};

const PREDICTIONS: usize = 3;

fn golden() -> Golden {
    Golden::read("tests/golden/losses.safetensors")
}

fn number(tensor: Tensor<1>) -> f32 {
    numbers(tensor)[0]
}

fn inputs(golden: &Golden, device: &Device) -> LossInputs {
    LossInputs {
        truth: golden.tensor("truth", device),
        valid: golden.tensor("valid", device),
        first_frame: golden.tensor("first_frame", device),
        second_frame: golden.tensor("second_frame", device),
        foreground: Some(golden.tensor("foreground", device)),
    }
}

/// The golden predictions as leaves of the autodiff graph.
fn predictions(golden: &Golden, device: &Device) -> Vec<Prediction> {
    let leaf = |name: &str, i: usize| golden.tensor::<4>(&format!("{name}_{i}"), device).require_grad();
    (0..PREDICTIONS)
        .map(|i| Prediction {
            flow: leaf("flow", i),
            mixture: Some(LaplaceMixture {
                log_weights: leaf("log_weights", i),
                log_scales: leaf("log_scales", i),
            }),
        })
        .collect()
}

/// Compares a part of the loss (or `total`) and its gradients with a golden case.
fn check(case: &str, part: &str, config: &LossConfig) {
    let golden = golden();
    let device = Device::flex().autodiff();
    let predictions = predictions(&golden, &device);
    let losses = losses(config, &predictions, &inputs(&golden, &device)).expect("a loss");
    let loss = match part {
        "total" => losses.total,
        _ => losses.parts.into_iter().find(|(name, _)| *name == part).expect(part).1,
    };
    let expected = golden.values(&format!("{case}.value"))[0];
    let found = number(loss.clone());
    assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{case}: {found} for {expected}");

    let grads = loss.backward();
    for (i, prediction) in predictions.iter().enumerate() {
        let mixture = prediction.mixture.as_ref().expect("stored");
        let leaves = [
            ("flow", &prediction.flow),
            ("log_weights", &mixture.log_weights),
            ("log_scales", &mixture.log_scales),
        ];
        for (leaf, tensor) in leaves {
            let name = format!("{case}.{leaf}_{i}");
            if !golden.has(&name) {
                assert!(tensor.grad(&grads).is_none(), "{name}: expected no gradient");
                continue;
            }
            let expected = golden.values(&name);
            let found = numbers(tensor.grad(&grads).expect("a gradient"));
            let largest = expected.iter().fold(0.0_f32, |largest, x| largest.max(x.abs()));
            assert!(largest > 0.0, "{name}: a case without a gradient checks nothing");
            for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
                assert!((found - expected).abs() <= 1e-4 * largest, "{name}, {at}: {found} for {expected}");
            }
        }
    }
}

#[test]
fn the_strain_loss_matches_the_reference() {
    check("strain", "strain", &LossConfig { strain: 1.0, ..LossConfig::default() });
}

#[test]
fn the_cyclic_loss_matches_the_reference() {
    check("cyclic", "cyclic", &LossConfig { cyclic: 1.0, ..LossConfig::default() });
}

/// Without any known flow, and with the border repeated.
#[test]
fn the_cyclic_loss_is_least_for_the_flow_between_the_frames() {
    let device = Device::flex();
    let size @ [height, width] = [4, 40];
    let frame = |shift: f32| {
        let value = |i: usize| 0.5 + 0.4 * ((i % width) as f32 / 4.0 - shift / 4.0).sin();
        let values: Vec<f32> = (0..3 * height * width).map(value).collect();
        Tensor::from_data(TensorData::new(values, [1, 3, height, width]), &device)
    };
    let inputs = LossInputs {
        first_frame: frame(0.0),
        second_frame: frame(2.0),
        ..constants(size, [f32::NAN, 0.0, 0.0], &device)
    };
    let config = LossConfig { cyclic: 1.0, ..LossConfig::default() };
    let loss = |u: f32| {
        let u = constant(u, size, 1, &device);
        let flow = Tensor::cat(vec![u.clone(), u.zeros_like()], 1);
        number(losses(&config, &[flow.into()], &inputs).expect("a loss").total)
    };
    let right = loss(2.0);
    for u in [-2.0, 0.0, 1.0, 3.0, 4.0] {
        assert!(loss(u) > 4.0 * right, "{u}: {}, the right flow {right}", loss(u));
    }
}

/// One regularizer with the paper's weight.
fn only(name: &str) -> LossConfig {
    let regularizer = REGULARIZERS.iter().find(|entry| entry.name == name).expect(name);
    LossConfig::default().with(regularizer, regularizer.paper_weight)
}

fn sequence(name: &str) -> &'static SequenceLoss {
    SEQUENCE_LOSSES.iter().find(|entry| entry.name == name).expect(name)
}

#[test]
fn sequence_losses_match_the_references() {
    for (case, name) in
        [("l1", "l1"), ("l2", "l2"), ("mixture", "mixture-of-laplace"), ("l1 and mixture", "l1-and-mixture")]
    {
        check(case, "sequence", &LossConfig { sequence: sequence(name), ..LossConfig::default() });
    }
}

#[test]
fn regularizers_match_the_papers_equations() {
    let zero = |name| LossConfig { border: Border::Zero, ..only(name) };
    let unit = |name| LossConfig { image_max: 1.0, ..only(name) };
    let literal = |name| LossConfig { m_total: MaskReading::Literal, ..only(name) };
    check("tvr replicate", "tvr", &only("tvr"));
    check("tvr zero", "tvr", &zero("tvr"));
    check("fdr", "fdr", &only("fdr"));
    check("migar replicate", "migar", &only("migar"));
    check("migar zero", "migar", &LossConfig { image_max: 1.0, ..zero("migar") });
    check("migar unit", "migar", &unit("migar"));
    check("migar literal", "migar", &literal("migar"));
    check("igvar replicate", "igvar", &only("igvar"));
    check("igvar zero", "igvar", &zero("igvar"));
    check("igvar unit", "igvar", &unit("igvar"));
    check("igvar literal", "igvar", &literal("igvar"));
}

/// The default loss with all regularizers.
fn all() -> LossConfig {
    let with = |config: LossConfig, regularizer| config.with(regularizer, regularizer.paper_weight);
    REGULARIZERS.iter().fold(LossConfig::default(), with)
}

#[test]
fn the_total_is_the_sum_of_the_parts() {
    check("all", "total", &all());
    let golden = golden();
    let device = Device::flex().autodiff();
    let found = losses(&all(), &predictions(&golden, &device), &inputs(&golden, &device)).expect("a loss");
    let names: Vec<&str> = found.parts.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["sequence", "tvr", "fdr", "migar", "igvar"]);
    let sum: f32 = found.parts.into_iter().map(|(_, part)| number(part)).sum();
    let total = number(found.total);
    assert!((sum - total).abs() < 1e-4 * total, "{sum} for {total}");
}

/// Along a random direction. The tolerance is wide because a few absolute values change sign within the step.
#[test]
fn gradients_match_finite_differences() {
    let golden = golden();
    let mixture = LossConfig { sequence: sequence("mixture-of-laplace"), ..LossConfig::default() };
    let l2 = LossConfig { sequence: sequence("l2"), ..LossConfig::default() };
    for config in [all(), l2, mixture] {
        let tracked = Device::flex().autodiff();
        let leaves = predictions(&golden, &tracked);
        let grads = losses(&config, &leaves, &inputs(&golden, &tracked)).expect("a loss").total.backward();
        let device = Device::flex().autodiff();
        let direction = golden.tensor::<4>("log_scales_0", &device);
        let flow = leaves[1].flow.grad(&grads).expect("a gradient");
        let along = number((flow * direction.clone()).sum());
        let moved = |by: f32| {
            let mut moved = predictions(&golden, &device);
            moved[1].flow = moved[1].flow.clone() + direction.clone() * by;
            number(losses(&config, &moved, &inputs(&golden, &device)).expect("a loss").total)
        };
        const STEP: f32 = 1.0 / 512.0;
        let expected = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
        let size = number(leaves[1].flow.grad(&grads).expect("a gradient").square().sum().sqrt());
        assert!(size > 0.01, "a flat loss checks nothing");
        assert!((along - expected).abs() < 0.1 * size, "{along} for {expected} (norm {size})");
    }
}

fn constant(value: f32, [height, width]: [usize; 2], channels: usize, device: &Device) -> Tensor<4> {
    Tensor::full([1, channels, height, width], value, device)
}

/// A constant truth, whether it is valid, and constant frames; no mask.
fn constants(size: [usize; 2], [truth, valid, frame]: [f32; 3], device: &Device) -> LossInputs {
    LossInputs {
        truth: constant(truth, size, 2, device),
        valid: constant(valid, size, 1, device),
        first_frame: constant(frame, size, 3, device),
        second_frame: constant(frame, size, 3, device),
        foreground: None,
    }
}

/// All losses, and the gradient of their total, for a constant prediction on a constant frame.
fn of_constants(
    size: [usize; 2],
    [flow, truth, valid, head]: [f32; 4],
    config: &LossConfig,
) -> (Vec<f32>, Vec<f32>) {
    let device = Device::flex().autodiff();
    let leaf = constant(flow, size, 2, &device).require_grad();
    let mixture = LaplaceMixture {
        log_weights: constant(0.0, size, 2, &device),
        log_scales: constant(0.0, size, 2, &device),
    };
    let prediction = Prediction { flow: leaf.clone(), mixture: Some(mixture) };
    let foreground = Some(constant(head, size, 1, &device));
    let inputs = LossInputs { foreground, ..constants(size, [truth, valid, 0.7], &device) };
    let losses = losses(config, &[prediction], &inputs).expect("a loss");
    let grads = losses.total.clone().backward();
    let parts = losses.parts.into_iter().map(|(_, part)| number(part)).collect();
    (parts, numbers(leaf.grad(&grads).expect("a gradient")))
}

#[test]
fn constant_images_and_flows_have_no_variation() {
    for size in [[7, 9], [1, 9], [9, 1], [1, 1], [2, 2]] {
        let (parts, grad) = of_constants(size, [3.0, 1.0, 1.0, 1.0], &all());
        assert!((parts[0] - 2.0).abs() < 1e-6, "{size:?}: {parts:?}");
        assert_eq!(parts[1..], [0.0; 4], "{size:?}");
        let expected = 1.0 / (2 * size[0] * size[1]) as f32;
        assert!(grad.iter().all(|x| (x - expected).abs() < 1e-6), "{size:?}: {grad:?}");
    }
}

#[test]
fn without_valid_pixels_losses_and_gradients_are_zero() {
    for (sequence, size) in
        SEQUENCE_LOSSES.iter().flat_map(|loss| [[6, 5], [1, 5], [1, 1]].map(|size| (loss, size)))
    {
        let config = LossConfig { sequence, ..all() };
        // No valid pixel, whatever the values of the truth, and no head.
        for truth in [0.0, f32::NAN, f32::INFINITY] {
            let (parts, grad) = of_constants(size, [3.0, truth, 0.0, 0.0], &config);
            assert!(
                parts.iter().chain(&grad).all(|x| *x == 0.0),
                "{sequence:?} {size:?}: {parts:?}, {grad:?}"
            );
        }
        // A NaN truth that is marked valid.
        let (parts, grad) = of_constants(size, [3.0, f32::NAN, 1.0, 1.0], &config);
        assert!(parts.iter().chain(&grad).all(|x| *x == 0.0), "{sequence:?} {size:?}: {parts:?}, {grad:?}");
    }
    // A correct prediction of zero, where the distance is not differentiable.
    for sequence in [sequence("l1"), sequence("l2")] {
        let (parts, grad) =
            of_constants([4, 4], [0.0; 4].map(|x| x + 0.0), &LossConfig { sequence, ..all() });
        assert!(parts[0] < 2e-6 && grad.iter().all(|x| *x == 0.0), "{sequence:?}: {parts:?}, {grad:?}");
        let (parts, grad) = of_constants([4, 4], [0.0, 0.0, 1.0, 1.0], &LossConfig { sequence, ..all() });
        assert!(parts[0] < 2e-6 && grad.iter().all(|x| *x == 0.0), "{sequence:?}: {parts:?}, {grad:?}");
    }
}

/// With frames in 0..255, the base of MIGAR's weights overflows and the weights underflow.
#[test]
fn frames_of_the_highest_contrast_give_finite_losses() {
    let device = Device::flex().autodiff();
    let [height, width] = [8, 10];
    let checkers: Vec<f32> = (0..3 * height * width)
        .map(|i| if (i % width / 2 + i / width / 2) % 2 == 0 { 1.0 } else { 0.0 })
        .collect();
    let first_frame = Tensor::from_data(TensorData::new(checkers, [1, 3, height, width]), &device);
    let ramp: Vec<f32> = (0..2 * height * width).map(|i| (i * i) as f32).collect();
    let flow = Tensor::<4>::from_data(TensorData::new(ramp, [1, 2, height, width]), &device).require_grad();
    let inputs = LossInputs {
        second_frame: first_frame.clone(),
        first_frame,
        ..constants([height, width], [0.0, 1.0, 0.0], &device)
    };
    let losses = losses(&all(), &[flow.clone().into()], &inputs).expect("a loss");
    let grad = numbers(flow.grad(&losses.total.clone().backward()).expect("a gradient"));
    let parts: Vec<f32> = losses.parts.into_iter().map(|(_, part)| number(part)).collect();
    assert!(parts.iter().chain(&grad).all(|x| x.is_finite()), "{parts:?}");
}

/// Computed by hand: for a head of 3x3 pixels in a 5x6 image, only the gradient of the mask at the centre is zero. A flow of 2 is
/// masked to 2 there and 0 elsewhere.
#[test]
fn the_mask_keeps_only_the_interior_of_the_head() {
    let device = Device::flex().autodiff();
    let [height, width] = [5, 6];
    let inside = |i: usize| (1..4).contains(&(i / width)) && (1..4).contains(&(i % width));
    let head: Vec<f32> = (0..height * width).map(|i| if inside(i) { 1.0 } else { 0.0 }).collect();
    let inputs = LossInputs {
        foreground: Some(Tensor::from_data(TensorData::new(head, [1, 1, height, width]), &device)),
        ..constants([height, width], [0.0, 1.0, 0.5], &device)
    };
    let value = |config: &LossConfig, part: &str| {
        let flow = constant(2.0, [height, width], 2, &device);
        let losses = losses(config, &[flow.into()], &inputs).expect("a loss");
        number(losses.parts.into_iter().find(|(name, _)| *name == part).expect(part).1)
    };
    // The absolute values of the kernel sum to 8; twice for x and y, twice for u and v.
    let expected = 2.0 * 8.0 * 2.0 * 2.0 / (height * width) as f32;
    for part in ["migar", "igvar"] {
        let found = value(&only(part), part);
        assert!((found - expected).abs() < 1e-5, "{part}: {found} for {expected}");
    }
    // As printed, the mask keeps only the top left pixel, whose derivatives have the same sum.
    let literal = LossConfig { m_total: MaskReading::Literal, ..only("migar") };
    assert!((value(&literal, "migar") - expected).abs() < 1e-5);
    assert_eq!(value(&all(), "tvr"), 0.0);
    assert_eq!(value(&all(), "fdr"), 0.0);
}

#[test]
fn without_a_mask_every_pixel_counts_as_head() {
    let golden = golden();
    let device = Device::flex().autodiff();
    let with = |foreground| LossInputs { foreground, ..inputs(&golden, &device) };
    let total = |inputs: LossInputs| {
        number(losses(&all(), &predictions(&golden, &device), &inputs).expect("a loss").total)
    };
    let whole = Tensor::ones(inputs(&golden, &device).valid.dims(), &device);
    assert_eq!(total(with(None)), total(with(Some(whole))));
    assert_ne!(total(with(None)), total(inputs(&golden, &device)));
}

#[test]
fn later_predictions_have_larger_weights() {
    let device = Device::flex().autodiff();
    let size = [4, 4];
    let inputs = constants(size, [0.0, 1.0, 0.0], &device);
    let flows = [1.0, 10.0, 100.0].map(|flow| constant(flow, size, 2, &device).into());
    let config = LossConfig { gamma: 0.5, ..LossConfig::default() };
    assert_eq!(number(losses(&config, &flows, &inputs).expect("a loss").total), 0.25 + 5.0 + 100.0);
}

#[test]
fn invalid_settings_are_reported() {
    assert_eq!(all().check(), Ok(()));
    for (config, message) in [
        (LossConfig { gamma: 1.5, ..all() }, "loss.gamma = 1.5: expected a number above 0 and at most 1"),
        (LossConfig { tvr: f64::NAN, ..all() }, "loss.tvr = NaN: expected a weight of 0 or more"),
        (LossConfig { igvar: -1.0, ..all() }, "loss.igvar = -1: expected a weight of 0 or more"),
        (LossConfig { image_max: 0.0, ..all() }, "loss.image_max = 0: expected 255"),
        (LossConfig { max_magnitude: 0.0, ..all() }, "loss.max_magnitude = 0:"),
        (LossConfig { log_scale_range: [1.0, 2.0], ..all() }, "loss.log_scale_range = [1, 2]:"),
    ] {
        let error = config.check().expect_err(message).to_string();
        assert!(error.starts_with(message), "{error}");
    }

    let device = Device::flex().autodiff();
    let flow = constant(0.0, [2, 2], 2, &device);
    let inputs = constants([2, 2], [0.0, 1.0, 0.0], &device);
    let mixture = LossConfig { sequence: sequence("mixture-of-laplace"), ..LossConfig::default() };
    let error = losses(&mixture, &[flow.into()], &inputs).expect_err("no mixture");
    assert_eq!(error, LossError::NoMixture);
}
