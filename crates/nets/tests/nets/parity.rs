//! Flow and gradients of every network against the reference implementation with the same parameters: ptlflow 0.4.2, or for networks
//! that it lacks, a version in `tools/parity`.
//!
//! `tools/parity/nets.py` makes the golden values; its rules for parameters and frames are repeated in `inputs`. Every network of the
//! table is compared with every file of its name in `tests/golden`, which also stores the settings of the reference.
//! `SRFLOW_TEST_DEVICE` selects the device (docs/guides/gpu.md), `SRFLOW_TEST_NETWORK` a single network.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData, s};
use srflow_nets::{
    Architecture, Estimate, Facts, Frames, LaplaceMixture, Memory, Network, Request, Start, load_network,
};
use srflow_nn::{HostGradients, Layout, Segment, parameter_infos, with_batch_statistics};
use srflow_ops::golden::{Golden, numbers};

use crate::inputs::{filled, frame};

/// Stored rows and columns of the flow: every seventh.
const EVERY: isize = 7;

/// Opened once, as enumerating devices takes time.
static DEVICE: LazyLock<Device> = LazyLock::new(|| {
    let name = std::env::var("SRFLOW_TEST_DEVICE");
    srflow_ops::device(name.as_deref().unwrap_or("cpu")).expect("the device of SRFLOW_TEST_DEVICE")
});

/// Every 7th row and column.
fn thinned(flow: Tensor<4>) -> Tensor<4> {
    flow.slice(s![.., .., ..;EVERY, ..;EVERY])
}

/// Compares `found` with the golden tensor, with limits on the mean and largest difference.
fn assert_close(golden: &Golden, name: &str, found: Tensor<4>, [mean, largest]: [f32; 2]) {
    assert_eq!(golden.shape(name), found.dims(), "{name}");
    let differences: Vec<f32> =
        numbers(found).iter().zip(golden.values(name)).map(|(a, b)| (a - b).abs()).collect();
    let worst = differences.iter().copied().fold(0.0, f32::max);
    let average = differences.iter().sum::<f32>() / differences.len() as f32;
    println!("{name}: mean difference {average:.2e} px, largest {worst:.2e} px");
    assert!(average <= mean && worst <= largest, "{name}: mean difference {average}, largest {worst}");
}

/// Batch, height and width of the cases of a network, and their golden values; cases without padding come first.
fn cases(architecture: Architecture) -> Vec<([usize; 3], Golden)> {
    let name = format!("{}_", architecture.name().replace('-', "_"));
    let files = std::fs::read_dir("tests/golden").expect("the folder of golden values");
    let mut cases: Vec<([usize; 3], PathBuf)> = files
        .map(|file| file.expect("an entry").path())
        .filter_map(|path| {
            let sizes = path.file_stem()?.to_str()?.strip_prefix(&name)?;
            let sizes = sizes.split('x').map(|size| size.parse().ok()).collect::<Option<Vec<usize>>>()?;
            Some((sizes.try_into().ok()?, path))
        })
        .collect();
    let padding = architecture.facts().padding;
    let padded = |[_, height, width]: [usize; 3]| height % padding != 0 || width % padding != 0;
    cases.sort_by_key(|(case, _)| (padded(*case), *case));
    let has =
        |padding, several| cases.iter().any(|(case, _)| padded(*case) == padding && (case[0] > 1) == several);
    assert!(has(false, false) && has(true, true), "{name}: a pair without padding, several with: {cases:?}");
    cases.into_iter().map(|(case, path)| (case, Golden::read(path))).collect()
}

/// All networks, or the one in `SRFLOW_TEST_NETWORK`.
fn networks() -> Vec<Architecture> {
    match std::env::var("SRFLOW_TEST_NETWORK") {
        Ok(name) => vec![Architecture::from_name(&name).expect("the network of SRFLOW_TEST_NETWORK")],
        Err(_) => Architecture::ALL.into(),
    }
}

fn frames(case: [usize; 3], device: &Device) -> Frames {
    pair(case, 1, device)
}

/// Pair `number` of the video, from 1.
fn pair(case: [usize; 3], number: i64, device: &Device) -> Frames {
    let frame = |number: i64| frame(case, 4 * number, device);
    Frames { first: frame(number - 1), second: frame(number) }
}

/// A request that starts from the golden file's flow, for a network whose own start the reference lacks.
fn request(
    golden: &Golden,
    network: &Network,
    [batch, height, width]: [usize; 3],
    iterations: usize,
) -> Request {
    let start = golden.has("start").then(|| {
        let Facts { padding, start: Start::Coarse(stride), .. } = *network.architecture().facts() else {
            panic!("{}: starts from a coarse flow", network.architecture().name())
        };
        let [height, width] = [height, width].map(|side| side.next_multiple_of(padding) / stride);
        let numbers = golden.values("start");
        let component = |of: &[f32]| {
            let at = |i: usize| of[0] + of[1] * (i % width) as f32 + of[2] * (i / width) as f32;
            (0..height * width).map(at).collect::<Vec<f32>>()
        };
        let flow = [component(&numbers[..3]), component(&numbers[3..])].concat();
        let flows = TensorData::new(flow.repeat(batch), [batch, 2, height, width]);
        Tensor::from_data(flows, &network.devices()[0])
    });
    Request { start, ..Request::new(iterations) }
}

/// Compares the flows of later pairs of a video with the golden values `next_P_N`, for networks with memory.
fn check_next(
    golden: &Golden,
    network: &Network,
    case: [usize; 3],
    iterations: usize,
    memory: Option<Memory>,
) {
    let mut memory = memory;
    for number in 2.. {
        let key = format!("next_{number}_{iterations}");
        if !golden.has(&key) {
            break;
        }
        let device = &network.devices()[0];
        let request = Request { memory, ..Request::new(iterations) };
        let estimate = network.forward(pair(case, number, device), &request);
        assert_close(golden, &key, thinned(estimate.last().clone()), [1e-3, 1e-2]);
        memory = estimate.memory;
    }
}

/// Numbers of iterations with golden values `flow_N`, ascending.
fn iterations(golden: &Golden) -> Vec<usize> {
    let number = |key: &str| key.strip_prefix("flow_")?.parse().ok();
    let mut numbers: Vec<usize> = golden.names().filter_map(number).collect();
    numbers.sort_unstable();
    assert!(!numbers.is_empty(), "a flow");
    numbers
}

#[test]
fn flow_matches_the_reference() {
    let device = DEVICE.clone();
    for architecture in networks() {
        println!("{}:", architecture.name());
        for (number, (case, golden)) in cases(architecture).into_iter().enumerate() {
            let mut network = filled(architecture.init(&device), &golden);
            assert_eq!(network.architecture(), architecture);
            // The reference of `srflow` has no correction at twice the size; the graph of ONNX has it.
            _ = network.set("fine_up_to", 0);
            for iterations in iterations(&golden) {
                // Other devices may be emulated in software, which takes minutes instead of seconds; one iteration of the
                // padded batch is enough there.
                if device != Device::flex() && number > 0 && iterations > 1 {
                    continue;
                }
                let request = request(&golden, &network, case, iterations);
                let estimate = network.forward(frames(case, &device), &request);
                let limits = if iterations == 1 { [1e-4, 1e-3] } else { [1e-3, 1e-2] };
                let coarse = format!("coarse_{iterations}");
                if golden.has(&coarse) {
                    assert_close(&golden, &coarse, estimate.coarse.clone().expect(&coarse), limits);
                }
                let limits = if iterations == 1 { [1e-3, 1e-2] } else { limits };
                let flow = format!("flow_{iterations}");
                assert_close(&golden, &flow, thinned(estimate.last().clone()), limits);
                let occlusion = format!("occlusion_{iterations}");
                assert_eq!(golden.has(&occlusion), architecture.facts().occlusion, "{occlusion}");
                if let Some(found) = estimate.occlusion {
                    assert_close(&golden, &occlusion, thinned(found), [1e-4, 1e-3]);
                }
                assert_eq!(estimate.mixtures.len(), usize::from(architecture.facts().mixture), "mixtures");
                for LaplaceMixture { log_weights, log_scales } in estimate.mixtures {
                    let parts = [("log_weights", log_weights), ("log_scales", log_scales)];
                    for (part, found) in parts {
                        assert_close(&golden, &format!("{part}_{iterations}"), thinned(found), limits);
                    }
                }
                check_next(&golden, &network, case, iterations, estimate.memory);
            }
        }
    }
}

/// The left upper 384x256 of a frame of Sintel, as `tools/parity/trained.py` cuts it.
fn real_frame(path: &Path, device: &Device) -> Tensor<4> {
    let image = srflow_files::read_image(path).expect("a frame");
    let pixels: Vec<f32> = image.pixels().iter().flatten().map(|value| f32::from(*value) / 255.0).collect();
    let rows = Tensor::<3>::from_data(TensorData::new(pixels, [image.height(), image.width(), 3]), device);
    rows.slice(s![0..256, 0..384, ..]).permute([2, 0, 1]).unsqueeze()
}

/// Needs the weights of the networks' authors and frames of Sintel, which are not part of the project; golden values by
/// `tools/parity/trained.py`.
#[test]
fn trained_flow_matches_the_reference() {
    let data = Path::new("../../../shared/data");
    if !data.is_dir() {
        eprintln!("skipped: shared-data: no trained weights in {}", data.display());
        return;
    }
    let device = DEVICE.clone();
    let [first, second] = [16, 17]
        .map(|number| real_frame(&data.join(format!("real-frames/sintel/frame_{number:04}.png")), &device));
    for (name, weights, iterations) in
        [("raft-small", "raft-small-authors.pth", 32), ("unimatch-sc2", "gmflow-two-scales.pth", 1)]
    {
        let architecture = Architecture::from_name(name).expect(name);
        let network = load_network(architecture, &data.join("weights").join(weights), &device).expect(name);
        let frames = Frames { first: first.clone(), second: second.clone() };
        let estimate = network.forward(frames, &Request::new(iterations));
        let golden = Golden::read(format!("tests/golden/trained/{name}.safetensors"));
        println!("{name}, trained:");
        assert_close(&golden, "flow", thinned(estimate.last().clone()), [1e-4, 1e-2]);
    }
}

/// Gradients of each parameter for the loss `mean((flow - [4, 2])^2)`, decayed by 0.8 from each flow to the one before, summed over
/// the pairs of a video.
fn gradients(network: &Network, pairs: Vec<Frames>, request: &Request) -> Vec<(String, Option<Vec<f32>>)> {
    let mut memory = None;
    let of_pairs = pairs.into_iter().map(|frames| {
        let request = Request { every_iteration: true, memory: memory.take(), ..request.clone() };
        let mut estimate = network.forward(frames, &request);
        memory = estimate.memory.take();
        loss(estimate)
    });
    let total = of_pairs.reduce(|sum, loss| sum + loss).expect("a pair");
    let gradients = total.backward();
    let (layout, _) = Layout::of(network);
    let mut sum = HostGradients::zero(&layout);
    sum.add(network, &layout, &gradients, 1.0);
    let of = |(segment, reached): (&Segment, bool)| {
        (segment.name.clone(), reached.then(|| sum.values[segment.range.clone()].to_vec()))
    };
    layout.segments().iter().zip(sum.reached.clone()).map(of).collect()
}

fn loss(estimate: Estimate) -> Tensor<1> {
    let device = estimate.last().device();
    let distance = |found: &Tensor<4>, truth: [f32; 2]| {
        let truth = Tensor::<1>::from_data(truth, &device).reshape([1, 2, 1, 1]);
        (found.clone() - truth).powi_scalar(2).mean()
    };
    let mut losses: Vec<Tensor<1>> = estimate.flows.iter().map(|flow| distance(flow, [4.0, 2.0])).collect();
    for (loss, LaplaceMixture { log_weights, log_scales }) in losses.iter_mut().zip(&estimate.mixtures) {
        *loss = loss.clone() + distance(log_weights, [1.0, -1.0]) + distance(log_scales, [2.0, -2.0]);
    }
    losses.into_iter().reduce(|sum, loss| sum * 0.8 + loss).expect("a flow")
}

/// Compares the gradients of all parameters with sampled golden values. The distance is the root mean square of the differences
/// relative to that of the whole gradient. Noise of 1e-7 in the frames, which moves some sums across the kink of a ReLU, changes
/// single values of the reference's gradients by up to 0.2 of it. Gradients of biases before an instance norm are only rounding
/// errors.
fn check_gradients(architecture: Architecture) {
    let device = DEVICE.clone().autodiff();
    let name = architecture.name();
    let infos = parameter_infos(&architecture.init(&device));
    let normed = infos.iter().any(|info| info.name.contains("running_"));
    let mut held = 0;
    for (case, golden) in cases(architecture) {
        if let Some(other) = golden.names().find_map(|key| key.strip_prefix("gradients/")) {
            let other = Architecture::from_name(&other.replace('_', "-")).expect(other);
            assert!(cases(other)[0].1.has("training_iterations"), "{name}: gradients of {}", other.name());
            held += 1;
            continue;
        }
        if !golden.has("training_iterations") {
            continue;
        }
        held += 1;
        let iterations = golden.values("training_iterations")[0] as usize;
        let pairs = if golden.has("training_pairs") { golden.values("training_pairs")[0] as i64 } else { 1 };
        assert_eq!(pairs > 1, architecture.facts().remembers, "{name}: a video, for networks that remember");
        let kinds = [("running", false), ("batch", true)].into_iter().filter(|(_, batch)| normed || !batch);
        for (kind, batch_statistics) in kinds {
            // A new network, as a pass with batch statistics updates the running ones, which clones share.
            let network =
                with_batch_statistics(filled(architecture.init(&device), &golden), batch_statistics);
            let video: Vec<Frames> = (1..=pairs).map(|number| pair(case, number, &device)).collect();
            let mut distances = Vec::new();
            let request = request(&golden, &network, case, iterations);
            for (parameter, gradient) in gradients(&network, video.clone(), &request) {
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
            let stored = golden.names().filter(|key| key.starts_with(&format!("{kind}/"))).count();
            assert_eq!(distances.len(), stored, "{case:?}, {kind}");
            let mean = distances.iter().sum::<f32>() / distances.len() as f32;
            let worst = distances.iter().copied().fold(0.0, f32::max);
            println!("{name} {case:?}, {kind}: {stored} gradients, mean {mean:.2e}, worst {worst:.2e}");
            assert!(mean < 1e-2, "{case:?}, {kind}: {mean}");
        }
    }
    assert!(held > 1, "{name}: gradients of a pair, and of several");
}

#[test]
fn gradients_match_the_reference() {
    networks().into_iter().filter(|network| network.facts().trains).for_each(check_gradients);
}

/// Running statistics of batch norm are not parameters in PyTorch.
#[test]
fn the_number_of_parameters_matches_the_reference() {
    for architecture in Architecture::ALL {
        let infos = parameter_infos(&architecture.init(&Device::flex()));
        let learned = infos.iter().filter(|info| !info.name.contains("running_"));
        let count: usize = learned.map(|info| info.shape.iter().product::<usize>()).sum();
        assert_eq!(count, architecture.facts().parameters, "{}", architecture.name());
    }
}
