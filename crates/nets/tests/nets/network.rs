//! Options of requests, and gradients by finite differences.

use std::collections::BTreeSet;

use burn::tensor::{Device, Tensor, TensorData};
use srflow_nets::{Architecture, Estimate, Frames, Network, Request};
use srflow_nn::{HostGradients, Layout, Parameters, parameter_infos, with_parameters};
use srflow_ops::golden::numbers;

/// Pseudorandom values in -1..1.
fn values(count: usize, seed: u32) -> Vec<f32> {
    (0..count as u32)
        .map(|i| {
            let bits = (i ^ (seed << 20)).wrapping_mul(0x9E37_79B9).rotate_left(13).wrapping_mul(0x85EB_CA6B);
            (bits >> 8) as f32 / 8_388_608.0 - 1.0
        })
        .collect()
}

/// Parameters that preserve the scale of activations.
fn parameters(network: &Network) -> Parameters {
    let infos = parameter_infos(network).into_iter().zip(1..);
    infos
        .map(|(info, seed)| {
            let fan_in: usize = info.shape[1..].iter().product();
            let numbers = values(info.shape.iter().product(), seed).into_iter().map(|x| {
                if info.shape.len() == 1 && !info.name.ends_with("bias") {
                    1.0 + 0.25 * x
                } else {
                    x * (1.5 / fan_in as f32).sqrt()
                }
            });
            let numbers: Vec<f32> = numbers.collect();
            (info.name, TensorData::new(numbers, info.shape))
        })
        .collect()
}

fn network(architecture: Architecture, device: &Device) -> Network {
    let network = architecture.init(device);
    let parameters = parameters(&network);
    with_parameters(network, parameters).expect("its own names and shapes")
}

fn frames(device: &Device) -> Frames {
    let frame = |seed| {
        let numbers = values(3 * 64 * 72, seed).into_iter().map(|x| 0.5 + 0.5 * x).collect::<Vec<f32>>();
        Tensor::from_data(TensorData::new(numbers, [1, 3, 64, 72]), device)
    };
    Frames { first: frame(1), second: frame(2) }
}

#[test]
fn every_iteration_returns_the_flow_of_each_iteration() {
    let device = Device::flex();
    for architecture in [Architecture::Raft, Architecture::RaftSmall, Architecture::SkFlow] {
        let network = network(architecture, &device);
        let all = Request { every_iteration: true, ..Request::new(3) };
        let all = network.forward(frames(&device), &all);
        assert_eq!(all.flows.len(), 3);
        for (iterations, flow) in (1..).zip(&all.flows) {
            let alone = network.forward(frames(&device), &Request::new(iterations));
            assert_eq!(alone.flows.len(), 1);
            assert!(
                numbers(alone.last().clone()) == numbers(flow.clone()),
                "{architecture:?}, {iterations} iterations"
            );
        }
    }
}

/// SEA-RAFT predicts a flow before its first iteration.
#[test]
fn the_initial_flow_comes_before_those_of_the_iterations() {
    let device = Device::flex();
    let network = network(Architecture::SeaRaftS, &device);
    let all = Request { every_iteration: true, ..Request::new(2) };
    let all = network.forward(frames(&device), &all);
    assert_eq!((all.flows.len(), all.mixtures.len()), (3, 3));
    let alone = network.forward(frames(&device), &Request::new(1));
    assert_eq!((alone.flows.len(), alone.mixtures.len()), (1, 1));
    let same = |a: &Tensor<4>, b: &Tensor<4>| numbers(a.clone()) == numbers(b.clone());
    assert!(same(alone.last(), &all.flows[1]) && !same(alone.last(), &all.flows[0]));
    assert!(same(&alone.mixtures[0].log_scales, &all.mixtures[1].log_scales));
    assert!(!same(&alone.mixtures[0].log_scales, &all.mixtures[0].log_scales));
}

/// Everything that two estimates are made of.
fn assert_same(found: &Estimate, expected: &Estimate, what: &str) {
    let tensors = |estimate: &Estimate| -> Vec<Vec<f32>> {
        assert_eq!(estimate.flows.len(), 1, "{what}");
        let mixtures =
            estimate.mixtures.iter().flat_map(|mixture| [&mixture.log_weights, &mixture.log_scales]);
        let rest = [&estimate.coarse, &estimate.hidden].into_iter().flatten();
        estimate.flows.iter().chain(mixtures).chain(rest).map(|tensor| numbers(tensor.clone())).collect()
    };
    assert_eq!(found.iterations, expected.iterations, "{what}");
    assert!(tensors(found) == tensors(expected), "{what}");
}

/// The number of iterations is that of the rule applied to the flows of each number of iterations, and the result that of a request for
/// this number.
#[test]
fn refinement_stops_once_the_flow_is_still() {
    const MOST: usize = 6;
    let device = Device::flex();
    let zero = || Some(Tensor::<4>::zeros([1, 2, 8, 9], &device));
    let mut counts = BTreeSet::new();
    for architecture in [
        Architecture::Raft,
        Architecture::RaftSmall,
        Architecture::Gma,
        Architecture::SkFlow,
        Architecture::MemFlow,
        Architecture::SeaRaftS,
    ] {
        let network = network(architecture, &device);
        let fixed: Vec<Estimate> = (1..=MOST)
            .map(|number| {
                network.forward(frames(&device), &Request { start: zero(), ..Request::new(number) })
            })
            .collect();
        let coarse = |estimate: &Estimate| numbers(estimate.coarse.clone().expect("a coarse flow"));
        let flows: Vec<Vec<f32>> =
            std::iter::once(vec![0.0; 2 * 8 * 9]).chain(fixed.iter().map(coarse)).collect();
        // The limit that each iteration's change reaches: its mean, or a quarter of its largest, as of 72 coarse pixels none may move
        // fast.
        let moves: Vec<f32> = flows
            .windows(2)
            .map(|pair| {
                let change: Vec<f32> = pair[1].iter().zip(&pair[0]).map(|(a, b)| 8.0 * (a - b)).collect();
                let (u, v) = change.split_at(8 * 9);
                let lengths: Vec<f32> = u.iter().zip(v).map(|(u, v)| u.hypot(*v)).collect();
                let mean = lengths.iter().sum::<f32>() / 72.0;
                (lengths.into_iter().fold(0.0, f32::max) / 4.0).max(mean)
            })
            .collect();
        let limits = moves.iter().map(|px| 1.001 * px).chain([1e-9, 1e6]);
        for px in limits {
            let still = |number: &usize| moves[number - 2] < px && moves[number - 1] < px;
            let expected = (2..MOST).find(still).unwrap_or(MOST);
            let request = Request { still_px: Some(px), start: zero(), ..Request::new(MOST) };
            let found = network.forward(frames(&device), &request);
            let what = format!("{architecture:?}, {px} px of {moves:?}");
            assert_eq!(found.iterations, Some(expected), "{what}");
            assert_same(&found, &fixed[expected - 1], &what);
            counts.insert(expected);
        }
    }
    assert!(counts.len() > 2, "also between the fewest and the most: {counts:?}");
}

/// Every network that refines its flow: all iterations or two at each level, and for a network with one level any number.
#[test]
fn every_refinement_can_stop() {
    let device = Device::flex();
    let refining = Architecture::ALL.into_iter().filter(|architecture| architecture.facts().refines());
    for architecture in refining {
        let mut network = network(architecture, &device);
        // RPKNet's are those of three levels together.
        let (most, fewest) = match architecture {
            Architecture::RpkNet => (9, 6),
            _ => (architecture.facts().iterations.default.min(5), 2),
        };
        let of = |network: &Network, still_px: Option<f32>, number: usize| {
            let request = Request { still_px, ..Request::new(number) };
            network.forward(frames(&device), &request)
        };
        let (never, soon) = (of(&network, Some(1e-9), most), of(&network, Some(1e6), most));
        assert_eq!((never.iterations, soon.iterations), (Some(most), Some(fewest)), "{architecture:?}");
        assert_same(&never, &of(&network, None, most), architecture.name());
        assert_same(&soon, &of(&network, None, fewest), architecture.name());
        // Iterations at its only level for the number of a request.
        let at_level = |number: usize| match architecture {
            Architecture::Ccmr => Some((8 * number).div_ceil(15)),
            Architecture::CcmrP => Some((8 * number).div_ceil(10)),
            Architecture::UniMatchSc2Ref6 => Some(number),
            _ => None,
        };
        if at_level(1).is_none() {
            continue;
        }
        _ = network.set("levels", 1); // UniMatch has no such setting
        for px in [64.0, 16.0, 4.0, 1.0, 0.25] {
            let found = of(&network, Some(px), most);
            let number = (1..=most).find(|number| at_level(*number) == found.iterations).expect("a number");
            assert_same(&found, &of(&network, None, number), &format!("{architecture:?}, {px} px"));
        }
    }
}

/// Training compares the flows of as many iterations for every sample.
#[test]
fn every_iteration_is_returned_although_the_flow_is_still() {
    let device = Device::flex();
    let network = network(Architecture::RaftSmall, &device);
    let request = Request { every_iteration: true, still_px: Some(1e6), ..Request::new(4) };
    let all = network.forward(frames(&device), &request);
    assert_eq!((all.flows.len(), all.iterations), (4, Some(4)));
}

/// DPFlow has a level more for each doubling of the diagonal, unless it is set; the coarsest has a pixel for each multiple of the
/// padding.
#[test]
fn levels_follow_the_size_of_the_frames_or_the_setting() {
    let mut network = Architecture::DpFlow.init(&Device::flex());
    let sizes = [[540, 960], [1080, 1920], [2160, 3840]];
    assert_eq!(sizes.map(|size| network.levels(size)), [3, 4, 5].map(Some));
    assert_eq!(sizes.map(|size| network.padding().of(size)), [32, 64, 128]);
    network.set("levels", 4).expect("a number of levels");
    assert_eq!(sizes.map(|size| network.levels(size)), [Some(4); 3]);
    assert_eq!(sizes.map(|size| network.padding().of(size)), [64; 3]);
    let coarse = network.forward(frames(&Device::flex()), &Request::new(1)).coarse.expect("a coarse flow");
    assert_eq!(coarse.dims(), [1, 2, 1, 2], "of 64x128 pixels");
    let levels = |architecture: Architecture| architecture.init(&Device::flex()).levels(sizes[1]);
    let others = [Architecture::RpkNet, Architecture::Ccmr, Architecture::CcmrP, Architecture::Raft];
    assert_eq!(others.map(levels), [Some(3), Some(3), Some(4), None]);
}

/// With fewer levels, CCMR+ returns the flow at the end of the last one.
#[test]
fn fewer_levels_return_the_flow_of_the_last_one() {
    let device = Device::flex();
    let mut network = network(Architecture::CcmrP, &device);
    let all = Request { every_iteration: true, ..Request::new(1) };
    let all = network.forward(frames(&device), &all);
    assert_eq!(all.flows.len(), 4);
    for (levels, flow) in (1..).zip(&all.flows) {
        network.set("levels", levels).expect("a number of levels");
        let fewer = network.forward(frames(&device), &Request::new(1));
        assert!(numbers(fewer.last().clone()) == numbers(flow.clone()), "{levels} levels");
    }
    assert!(network.set("levels", 5).is_err());
}

#[test]
fn refinement_starts_from_the_requested_flow() {
    let device = Device::flex();
    for (architecture, size) in [
        (Architecture::Raft, [8, 9]),
        (Architecture::RpkNet, [2, 3]),
        (Architecture::DpFlow, [2, 3]),
        (Architecture::Ccmr, [4, 6]),
    ] {
        let mut network = network(architecture, &device);
        if architecture == Architecture::Ccmr {
            // At finer levels, one iteration changes more than this start, which points out of the frame.
            network.set("levels", 1).expect("a number of levels");
        }
        let from = |start: Option<Tensor<4>>| {
            let request = Request { start, ..Request::new(1) };
            network.forward(frames(&device), &request).coarse.expect("a coarse flow")
        };
        let zero = Tensor::<4>::zeros([1, 2, size[0], size[1]], &device);
        assert!(numbers(from(None)) == numbers(from(Some(zero.clone()))), "{architecture:?}");
        let moved = numbers(from(Some(zero + 5.0)));
        let difference = moved.iter().zip(numbers(from(None))).map(|(a, b)| a - b);
        // One iteration changes the flow little, so most of the start remains.
        let mean = difference.sum::<f32>() / moved.len() as f32;
        assert!((mean - 5.0).abs() < 2.5, "{architecture:?}: moved by {mean} on average");
    }
}

/// Central differences. One iteration only: later ones depend on the detached flow, which gradients ignore.
#[test]
fn gradients_of_parameters_match_finite_differences() {
    let plain = Device::flex();
    let tracked = Device::flex().autodiff();
    let weights = values(2 * 64 * 72, 3);
    let weighted = |flow: &Tensor<4>| -> f64 {
        numbers(flow.clone()).iter().zip(&weights).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    // Short steps where activations are strongly nonlinear, long ones where the flow changes little.
    let cases: [(Architecture, &[(&str, f64)]); 2] = [
        (
            Architecture::Raft,
            &[
                ("fnet.layer2.0.conv1.weight", 1e-3),
                ("cnet.layer3.0.downsample.1.weight", 3e-3),
                ("update_block.gru.convq2.weight", 1e-2),
            ],
        ),
        (
            Architecture::SkFlow,
            &[
                ("att.to_qk.weight", 1e-2),
                ("update_block.aggregator.gamma", 1e-2),
                ("update_block.gru.ffn1.0.weight", 1e-2),
                ("update_block.gru.conv_list.1.weight", 1e-2),
            ],
        ),
    ];
    for (architecture, names) in cases {
        let network = network(architecture, &tracked);
        let estimate = network.forward(frames(&tracked), &Request::new(1));
        let weight = Tensor::from_data(TensorData::new(weights.clone(), [1, 2, 64, 72]), &tracked);
        let grads = (estimate.last().clone() * weight).sum().backward();
        let (layout, _) = Layout::of(&network);
        let mut gradients = HostGradients::zero(&layout);
        gradients.add(&network, &layout, &grads, 1.0);
        for &(name, step) in names {
            let segment = layout.segments().iter().find(|segment| segment.name == name).expect(name);
            let grad = &gradients.values[segment.range.clone()];
            let norm = grad.iter().map(|x| f64::from(x * x)).sum::<f64>().sqrt();
            assert!(norm > 0.0, "{name} has a gradient");
            // Along the gradient, where the change is largest compared with rounding errors.
            let moved = |by: f64| {
                let other = architecture.init(&plain);
                let mut parameters = parameters(&other);
                let data = parameters.get_mut(name).expect("the parameter");
                let shape = data.shape().clone();
                let numbers: Vec<f32> = data.try_to_vec().expect("f32");
                let numbers: Vec<f32> = numbers
                    .iter()
                    .zip(grad)
                    .map(|(x, g)| (f64::from(*x) + by * f64::from(*g) / norm) as f32)
                    .collect();
                *data = TensorData::new(numbers, shape);
                let other = with_parameters(other, parameters).expect("its own names and shapes");
                weighted(other.forward(frames(&plain), &Request::new(1)).last())
            };
            let found = (moved(step) - moved(-step)) / (2.0 * step);
            assert!((found - norm).abs() < 0.05 * norm, "{architecture:?} {name}: {norm} for {found}");
        }
    }
}
