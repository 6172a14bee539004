//! Every network gives the flow of the reference implementation (ptlflow 0.4.2) from the same parameters, and in training
//! the gradients.
//!
//! Golden values: `tools/parity/nets.py`, whose rules for parameters and frames are repeated here. `SRFLOW_TEST_DEVICE`
//! names the device; see docs/devices.md.

use std::sync::LazyLock;

use burn::tensor::{Device, Tensor, TensorData, s};
use srflow_golden::{Golden, name_hash, noise, numbers};
use srflow_nets::{Architecture, Frames, Network, Request};
use srflow_nn::{
    HostGradients, Layout, Parameters, Segment, parameter_infos, with_batch_statistics, with_parameters,
};

/// Batch, height, width: one that needs no padding, one that does.
const CASES: [[usize; 3]; 2] = [[1, 128, 160], [2, 133, 150]];
/// Rows and columns of the flow that are stored.
const EVERY: isize = 7;
/// Parts of SKFlow's blocks that are added to their own input.
const RESIDUAL: [&str; 3] = ["ffn1.2.", "conv_list.", "pw."];

/// Found once: to ask drivers for their devices takes time.
static DEVICE: LazyLock<Device> = LazyLock::new(|| {
    let name = std::env::var("SRFLOW_TEST_DEVICE");
    srflow_ops::device(name.as_deref().unwrap_or("cpu")).expect("the device of SRFLOW_TEST_DEVICE")
});

/// Weights of variance 1 / fan_in, so that activations keep their size; the rest near what training leaves.
fn parameter(name: &str, shape: &[usize]) -> Vec<f32> {
    let count: usize = shape.iter().product();
    let seed = name_hash(name);
    let last = name.rsplit('.').next().unwrap_or_default();
    let fan_in: usize = shape[1..].iter().product();
    (0..count as u32)
        .map(|i| {
            let mut u = noise(i, seed);
            match last {
                "running_var" => return 1.0 + 0.5 * u,
                "gamma" => return 0.5 + 0.25 * u,
                "weight" if shape.len() == 1 => return 1.0 + 0.25 * u,
                _ => {}
            }
            if RESIDUAL.iter().any(|part| name.contains(part)) {
                u *= 0.5;
            }
            if name.contains("flow_head.ffn2.2.") {
                u *= 0.25; // keeps SKFlow's flow inside the frame
            }
            if last == "weight" { u * (3.0 / fan_in as f64).sqrt() as f32 } else { 0.1 * u }
        })
        .collect()
}

fn filled(network: Network) -> Network {
    let parameters: Parameters = parameter_infos(&network)
        .into_iter()
        .map(|info| {
            let values = parameter(&info.name, &info.shape);
            (info.name, TensorData::new(values, info.shape))
        })
        .collect();
    with_parameters(network, parameters).expect("its own names and shapes")
}

/// A triangle wave of whole numbers, in 0..1.
fn wave(n: i64, period: i64) -> f64 {
    (n.rem_euclid(2 * period) - period).abs() as f64 / period as f64
}

/// Three waves and some grain, moved by `shift` pixels right and half of it down.
fn frame([batch, height, width]: [usize; 3], shift: i64, device: &Device) -> Tensor<4> {
    let mut values = Vec::with_capacity(batch * 3 * height * width);
    for (n, c) in (0..batch as i64).flat_map(|n| (0..3).map(move |c| (n, c))) {
        for (y, x) in (0..height as i64).flat_map(|y| (0..width as i64).map(move |x| (y, x))) {
            let (x, y) = (x - shift + 64, y - shift / 2 + 64);
            let grain = noise(((x + 331 * y + 7919 * c + 104_729 * n) % (1 << 18)) as u32, 5);
            let value = 0.25 * wave(x + 2 * y + 5 * c, 13) + 0.25 * wave(3 * x - y + 1000 + 17 * n, 19);
            values.push((value + 0.3 * wave(x * y / 8 + 3 * c, 29) + 0.1 + 0.1 * f64::from(grain)) as f32);
        }
    }
    Tensor::from_data(TensorData::new(values, [batch, 3, height, width]), device)
}

/// Every 7th row and column.
fn thinned(flow: Tensor<4>) -> Tensor<4> {
    flow.slice(s![.., .., ..;EVERY, ..;EVERY])
}

/// Holds `found` to the stored tensor: mean and largest difference in pixels of the flow's own grid.
fn assert_close(golden: &Golden, name: &str, found: Tensor<4>, [mean, largest]: [f32; 2]) {
    assert_eq!(golden.shape(name), found.dims(), "{name}");
    let differences: Vec<f32> =
        numbers(found).iter().zip(golden.values(name)).map(|(a, b)| (a - b).abs()).collect();
    let worst = differences.iter().copied().fold(0.0, f32::max);
    let average = differences.iter().sum::<f32>() / differences.len() as f32;
    println!("{name}: mean difference {average:.2e} px, largest {worst:.2e} px");
    assert!(average <= mean && worst <= largest, "{name}: mean difference {average}, largest {worst}");
}

fn read_golden(name: &str, [batch, height, width]: [usize; 3]) -> Golden {
    Golden::read(format!("tests/golden/{name}_{batch}x{height}x{width}.safetensors"))
}

fn check(name: &str, architecture: Architecture) {
    let device = DEVICE.clone();
    let network = filled(architecture.init(&device));
    assert_eq!(network.architecture(), architecture);
    for case in CASES {
        let golden = read_golden(name, case);
        let frames = Frames { first: frame(case, 0, &device), second: frame(case, 4, &device) };
        let first = network.forward(frames.clone(), &Request::new(1));
        assert_close(&golden, "coarse_1", first.coarse, [1e-4, 1e-3]);
        // Another device may be a software one, which takes minutes for what the processor does in seconds: there one
        // iteration has to do for the batch with borders.
        if device != Device::flex() && case != CASES[0] {
            continue;
        }
        let last = network.forward(frames, &Request::new(12));
        assert_close(&golden, "coarse_12", last.coarse.clone(), [1e-3, 1e-2]);
        assert_close(&golden, "flow_12", thinned(last.last().clone()), [1e-3, 1e-2]);
    }
}

/// By parameter, after a backward pass of the mean of `(flow - [4, 2])^2`, weighted with 0.8 towards the last of 3 iterations.
fn gradients(network: &Network, frames: Frames) -> Vec<(String, Option<Vec<f32>>)> {
    let device = frames.first.device();
    let request = Request { every_iteration: true, ..Request::new(3) };
    let truth = Tensor::<1>::from_data([4.0, 2.0], &device).reshape([1, 2, 1, 1]);
    let flows = network.forward(frames, &request).flows;
    let of_one = |(i, flow): (usize, Tensor<4>)| {
        (flow - truth.clone()).powi_scalar(2).mean() * 0.8_f64.powi(2 - i as i32)
    };
    let gradients = flows.into_iter().enumerate().map(of_one).reduce(|a, b| a + b).expect("3").backward();
    let (layout, _) = Layout::of(network);
    let mut sum = HostGradients::zero(&layout);
    sum.add(network, &layout, &gradients, 1.0);
    let of = |(segment, reached): (&Segment, bool)| {
        (segment.name.clone(), reached.then(|| sum.values[segment.range.clone()].to_vec()))
    };
    layout.segments().iter().zip(sum.reached.clone()).map(of).collect()
}

/// Holds the gradients of all parameters to the stored numbers. Distances are root mean squares, relative to that of all the
/// gradient's numbers: a noise of 1e-7 in the frames, which moves some sums to the other side of a ReLU's kink, changes single
/// numbers of the reference's gradients by up to 0.2 of it. What an instance norm takes away again has a gradient of rounding
/// errors only.
fn check_gradients(name: &str, architecture: Architecture) {
    let device = DEVICE.clone().autodiff();
    for case in CASES {
        let golden = read_golden(name, case);
        for (kind, batch_statistics) in [("running", false), ("batch", true)] {
            // A new network: a pass with the batch's statistics moves the running ones, which clones share.
            let network = with_batch_statistics(filled(architecture.init(&device)), batch_statistics);
            let frames = Frames { first: frame(case, 0, &device), second: frame(case, 4, &device) };
            let mut distances = Vec::new();
            for (parameter, gradient) in gradients(&network, frames) {
                let key = format!("{kind}/{parameter}");
                let Some(gradient) = gradient else {
                    assert!(!golden.has(&key), "{key}: no gradient");
                    continue;
                };
                let (size, expected) = golden.values(&key).split_first().expect("17 numbers");
                let found = (0..expected.len()).map(|i| gradient[i * gradient.len() / expected.len()]);
                let square = found.zip(expected).map(|(found, expected)| (found - expected).powi(2));
                let distance = (square.sum::<f32>() / expected.len() as f32).sqrt() / size.max(1e-2);
                assert!(distance < 0.2, "{case:?}, {key}: {distance}");
                distances.push(distance);
            }
            let stored = golden.names().filter(|key| key.starts_with(kind)).count();
            assert_eq!(distances.len(), stored, "{case:?}, {kind}");
            let mean = distances.iter().sum::<f32>() / distances.len() as f32;
            let worst = distances.iter().copied().fold(0.0, f32::max);
            println!("{name} {case:?}, {kind}: {stored} gradients, mean {mean:.2e}, worst {worst:.2e}");
            assert!(mean < 1e-2, "{case:?}, {kind}: {mean}");
        }
    }
}

#[test]
fn raft() {
    check("raft", Architecture::Raft);
    check_gradients("raft", Architecture::Raft);
}

#[test]
fn raft_small() {
    check("raft_small", Architecture::RaftSmall);
    check_gradients("raft_small", Architecture::RaftSmall);
}

#[test]
fn gma() {
    check("gma", Architecture::Gma);
    check_gradients("gma", Architecture::Gma);
}

#[test]
fn skflow() {
    check("skflow", Architecture::SkFlow);
    check_gradients("skflow", Architecture::SkFlow);
}

/// Parameter counts of ptlflow's models, whose batch norm statistics are no parameters there.
#[test]
fn the_networks_have_the_references_parameters() {
    let expected = [5_257_536, 990_162, 5_879_873, 6_273_149];
    for (architecture, expected) in Architecture::ALL.into_iter().zip(expected) {
        let infos = parameter_infos(&architecture.init(&Device::flex()));
        let learned = infos.iter().filter(|info| !info.name.contains("running_"));
        let count: usize = learned.map(|info| info.shape.iter().product::<usize>()).sum();
        assert_eq!(count, expected, "{}", architecture.name());
        assert_eq!(count, architecture.facts().parameters, "{}", architecture.name());
    }
}
