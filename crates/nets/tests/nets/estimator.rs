//! Networks as estimators: sequences, batches, tiles, scales and warm starts.

use std::num::NonZeroUsize;

use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Device, Tensor, TensorData};
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, Image, Plane, Size, forward_interpolate,
};
use srflow_nets::{
    Architecture, Frames, Iterations, Network, NetworkEstimator, Padding, Request, TileSize, Tiling, Wrapped,
};
use srflow_nn::{parameters, with_parameters};
use srflow_ops::Precision;

const ITERATIONS: usize = 3;

fn network() -> Network {
    Architecture::RaftSmall.init(&Device::flex())
}

fn tiling(width: usize, height: usize, overlap: usize) -> Tiling {
    Tiling { size: TileSize::Fixed(Size { width, height }), overlap, alignment: Padding::Fixed(8) }
}

fn estimator(network: &Network) -> NetworkEstimator {
    let iterations = NonZeroUsize::new(ITERATIONS).expect("some");
    NetworkEstimator::new("raft-small", network.clone(), iterations, Device::flex())
}

/// A texture that moves by 3 pixels to the right and 1 down per frame.
fn frame(width: usize, height: usize, number: usize) -> Image {
    Image::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 - 3.0 * number as f32, y as f32 - number as f32);
        let wave = |a: f32, b: f32| ((a * x + b * y).sin() * 60.0 + 128.0) as u8;
        [wave(0.31, 0.12), wave(-0.17, 0.4), wave(0.07, 0.23)]
    })
}

fn video(width: usize, height: usize, frames: usize) -> Vec<Image> {
    (0..frames).map(|number| frame(width, height, number)).collect()
}

/// Of all frames at once.
fn flows_of(estimator: &dyn FlowEstimator, warm_start: bool, frames: &[Image]) -> Vec<FlowField> {
    let estimates = estimator.sequence(warm_start).push(frames).expect("flows");
    estimates.into_iter().map(|estimate| estimate.flow).collect()
}

/// RGB in 0..1, channels first.
fn tensor(image: &Image) -> Tensor<4> {
    let channel = |channel: usize| image.pixels().iter().map(move |pixel| f32::from(pixel[channel]) / 255.0);
    let numbers: Vec<f32> = (0..3).flat_map(channel).collect();
    Tensor::from_data(TensorData::new(numbers, [1, 3, image.height(), image.width()]), &Device::flex())
}

fn field(flow: Tensor<4>) -> FlowField {
    let [_, _, height, width] = flow.dims();
    let numbers: Vec<f32> = flow.into_data().try_to_vec().expect("f32");
    let (u, v) = numbers.split_at(width * height);
    FlowField::from_fn(width, height, |x, y| [u[y * width + x], v[y * width + x]])
}

fn assert_near(found: &FlowField, expected: &FlowField, what: &str) {
    assert_eq!(found.size(), expected.size(), "{what}");
    let pairs = found.pixels().as_flattened().iter().zip(expected.pixels().as_flattened());
    let far = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let longest = expected.pixels().as_flattened().iter().fold(0.0, |most: f32, value| most.max(value.abs()));
    assert!(far <= 1e-4 + 1e-4 * longest && longest > 1e-3, "{what}: {far} px apart of {longest}");
}

/// For frames that need padding.
#[test]
fn an_estimate_is_the_flow_of_the_network() {
    let network = network();
    let (first, second) = (frame(203, 150, 0), frame(203, 150, 1));
    let frames = Frames { first: tensor(&first), second: tensor(&second) };
    let expected = network.forward(frames, &Request::new(ITERATIONS));
    let found = estimator(&network).estimate(&first, &second).expect("flow");
    assert_near(&found, &field(expected.last().clone()), "estimate");
}

#[test]
fn a_sequence_gives_the_flow_of_every_pair_in_pieces_of_any_length() {
    let network = network();
    let estimator = estimator(&network);
    let frames = video(140, 131, 5);
    let pairs: Vec<FlowField> =
        frames.windows(2).map(|pair| estimator.estimate(&pair[0], &pair[1]).expect("flow")).collect();
    for pieces in [vec![5], vec![1, 1, 1, 1, 1], vec![2, 3], vec![1, 4]] {
        let mut sequence = estimator.sequence(false);
        let (mut rest, mut flows) = (frames.as_slice(), Vec::new());
        for piece in &pieces {
            let (now, later) = rest.split_at(*piece);
            rest = later;
            flows.extend(sequence.push(now).expect("flows").into_iter().map(|estimate| estimate.flow));
        }
        assert_eq!(flows.len(), 4);
        for (number, (found, expected)) in flows.iter().zip(&pairs).enumerate() {
            assert_near(found, expected, &format!("pair {number} of {pieces:?}"));
        }
    }
}

/// Untiled, tiled and scaled.
#[test]
fn batches_give_the_flow_of_each_pair() {
    let network = network();
    let boxed = || Box::new(estimator(&network));
    let tiled = Wrapped::new(boxed()).tiled(tiling(128, 128, 64));
    let scaled = Wrapped::new(boxed()).scaled(0.9).expect("in range");
    let frames = video(170, 140, 4);
    let pairs = [[&frames[0], &frames[1]], [&frames[3], &frames[0]], [&frames[1], &frames[1]]];
    for estimator in [&estimator(&network) as &dyn FlowEstimator, &tiled, &scaled] {
        let flows = estimator.estimate_pairs(&pairs).expect("flows");
        assert_eq!(flows.len(), pairs.len());
        for (estimate, [first, second]) in flows.iter().zip(pairs) {
            assert_near(&estimate.flow, &estimator.estimate(first, second).expect("flow"), "one of several");
        }
        assert!(estimator.estimate_pairs(&[]).expect("nothing").is_empty());
        let smaller = frame(160, 140, 0);
        let error = estimator.estimate_pairs(&[pairs[0], [&smaller, &smaller]]).expect_err("two sizes");
        assert!(matches!(error, EstimateError::SizeMismatch { .. }), "{error}");
    }
}

/// As in RAFT's evaluation on Sintel.
#[test]
fn a_warm_start_is_the_forward_warped_coarse_flow() {
    let network = network();
    let frames = video(136, 128, 3);
    let pair = |n: usize| Frames { first: tensor(&frames[n]), second: tensor(&frames[n + 1]) };
    let first = network.forward(pair(0), &Request::new(ITERATIONS));
    let moved = forward_interpolate(&field(first.coarse.clone().expect("a coarse flow")));
    let numbers: Vec<f32> =
        (0..2).flat_map(|axis| moved.pixels().iter().map(move |vector| vector[axis])).collect();
    let start = Tensor::from_data(TensorData::new(numbers, [1, 2, 16, 17]), &Device::flex());
    let cold = network.forward(pair(1), &Request::new(ITERATIONS));
    let expected = network.forward(pair(1), &Request { start: Some(start), ..Request::new(ITERATIONS) });

    let estimator = estimator(&network);
    let flows = flows_of(&estimator, true, &frames);
    assert_near(&flows[0], &field(first.flows[0].clone()), "the first starts from zero");
    let expected = field(expected.last().clone());
    assert_near(&flows[1], &expected, "the second starts from the first");
    assert!(field(cold.last().clone()) != expected, "the start makes a difference");
}

/// MemFlow with a nonzero `gamma`: it is initialized to zero, which disables attention.
fn memflow() -> Network {
    let network = Architecture::MemFlow.init(&Device::flex());
    let mut values = parameters(&network);
    values.insert("update_block.aggregator.gamma".into(), TensorData::new(vec![1.0_f32], [1]));
    with_parameters(network, values).expect("its own names and shapes")
}

/// Two concatenated videos.
#[test]
fn a_sequence_remembers_earlier_pairs_but_not_across_a_cut() {
    let network = memflow();
    let estimator = estimator(&network);
    let (width, height) = (140, 131);
    let negative = |frame: Image| {
        Image::from_fn(width, height, |x, y| frame.get(width - 1 - x, y).map(|level| level / 4))
    };
    let dark = video(width, height, 3).into_iter().map(negative);
    let frames: Vec<Image> = video(width, height, 4).into_iter().chain(dark).collect();
    let mut memory = None;
    let mut expected = Vec::new();
    for (number, pair) in frames.windows(2).enumerate() {
        let across = number == 3;
        memory = memory.filter(|_| !across);
        let frames = Frames { first: tensor(&pair[0]), second: tensor(&pair[1]) };
        let estimate = network.forward(frames, &Request { memory, ..Request::new(ITERATIONS) });
        expected.push(field(estimate.last().clone()));
        memory = estimate.memory.filter(|_| !across);
    }
    let flows = flows_of(&estimator, false, &frames);
    assert_eq!(flows.len(), expected.len());
    for (number, (found, expected)) in flows.iter().zip(&expected).enumerate() {
        assert_near(found, expected, &format!("pair {number}"));
        let alone = estimator.estimate(&frames[number], &frames[number + 1]).expect("flow");
        let same = [0, 3, 4].contains(&number);
        assert_eq!(alone == *found, same, "pair {number}: memory is used, but not across a cut");
    }
}

/// A pair need not start with the last frame of the previous pair, such as with windows that move.
#[test]
fn memory_is_kept_when_windows_move() {
    let network = memflow();
    let frames = video(150, 131, 3);
    let tiled = Wrapped::new(Box::new(estimator(&network))).tiled(tiling(200, 200, 64));
    let estimator = estimator(&network);
    let window = |number: usize, left: usize| frames[number].crop(left, 0, 140, 131);
    let pairs = [[window(0, 0), window(1, 0)], [window(1, 3), window(2, 3)]];
    let mut sequence = estimator.sequence(false);
    let flows = pairs.each_ref().map(|pair| sequence.push_pair(pair.each_ref()).expect("flow").flow);
    let alone = pairs.each_ref().map(|[first, second]| estimator.estimate(first, second).expect("flow"));
    assert_near(&flows[0], &alone[0], "the first");
    assert!(flows[1] != alone[1], "the second remembers the first");
    // Pairs that share frames give the same as pushing the frames.
    let same = [[&frames[0], &frames[1]], [&frames[1], &frames[2]]];
    let pushed = flows_of(&estimator, false, &frames);
    for estimator in [&estimator as &dyn FlowEstimator, &tiled] {
        let mut sequence = estimator.sequence(false);
        for (pair, pushed) in same.iter().zip(&pushed) {
            assert_near(&sequence.push_pair(*pair).expect("flow").flow, pushed, "the same frames");
        }
    }
    let mut sequence = estimator.sequence(false);
    assert!(sequence.push_pair([&frames[0], &window(1, 0)]).is_err(), "of two sizes");
    assert_eq!(sequence.push_pair([&frames[0], &frames[1]]).expect("flow").flow.size(), Size::new(150, 131));
}

/// Without padding, with padding, and for frames below the smallest size.
#[test]
fn an_initial_flow_is_reduced_to_the_coarse_start() {
    let network = network();
    let estimator = estimator(&network);
    for ([width, height], grid) in [([136, 128], [16, 17]), ([131, 150], [19, 17]), ([60, 50], [16, 16])] {
        let (first, second) = (frame(width, height, 0), frame(width, height, 1));
        let initial = FlowField::filled(width, height, [4.0, -2.0]);
        let found = estimator.estimate_from(&first, &second, &initial);
        let start = TensorData::new(
            [0.5, -0.25].into_iter().flat_map(|part| vec![part; grid[0] * grid[1]]).collect::<Vec<f32>>(),
            [1, 2, grid[0], grid[1]],
        );
        let larger = |image: &Image| {
            let inside =
                |place: usize, side: usize| place.saturating_sub((side.max(128) - side) / 2).min(side - 1);
            Image::from_fn(width.max(128), height.max(128), |x, y| {
                image.get(inside(x, width), inside(y, height))
            })
        };
        let frames = Frames { first: tensor(&larger(&first)), second: tensor(&larger(&second)) };
        let request =
            Request { start: Some(Tensor::from_data(start, &Device::flex())), ..Request::new(ITERATIONS) };
        let whole = field(network.forward(frames, &request).last().clone());
        let (left, top) = ((whole.width() - width) / 2, (whole.height() - height) / 2);
        let expected = whole.crop(left, top, width, height);
        assert_near(&found.expect("flow").flow, &expected, &format!("{width}x{height}"));
    }
    let (first, second) = (frame(130, 128, 0), frame(130, 128, 1));
    let error = estimator.estimate_from(&first, &second, &FlowField::new(128, 128)).expect_err("other size");
    assert!(matches!(error, EstimateError::SizeMismatch { .. }), "{error}");
}

#[test]
fn frames_of_any_size_have_a_flow() {
    for architecture in [Architecture::RaftSmall, Architecture::DpFlow, Architecture::CcmrP] {
        let estimator = estimator(&architecture.init(&Device::flex()));
        for (width, height) in [(1, 1), (16, 16), (1, 130), (127, 9), (129, 128)] {
            let [first, second] = [0, 1].map(|number| frame(width, height, number));
            let flow = estimator.estimate(&first, &second).expect("flow");
            assert_eq!(flow.size(), first.size());
            assert!(flow.pixels().as_flattened().iter().all(|value| value.is_finite()), "{architecture:?}");
        }
    }
    let estimator = estimator(&network());
    let nothing = Image::new(0, 0);
    assert_eq!(estimator.estimate(&nothing, &nothing).expect("nothing").size(), nothing.size());
    let error = estimator.estimate(&frame(130, 128, 0), &frame(128, 130, 0)).expect_err("other size");
    assert!(matches!(error, EstimateError::SizeMismatch { .. }), "{error}");
    let mut sequence = estimator.sequence(false);
    assert!(sequence.push(&[frame(130, 128, 0), frame(128, 130, 0)]).is_err());
}

#[test]
fn tiles_and_scales_give_the_same_flow_in_a_sequence() {
    let network = network();
    let frames = video(300, 160, 3);
    let boxed = || Box::new(estimator(&network));
    let whole = Wrapped::new(boxed()).tiled(tiling(300, 200, 64));
    let expected = estimator(&network).estimate(&frames[0], &frames[1]).expect("flow");
    assert_near(&whole.estimate(&frames[0], &frames[1]).expect("flow"), &expected, "one tile");

    let tiled = Wrapped::new(boxed()).tiled(tiling(192, 128, 64));
    let scaled = Wrapped::new(boxed()).tiled(tiling(160, 128, 32)).scaled(0.75).expect("in range");
    for estimator in [&tiled as &dyn FlowEstimator, &scaled] {
        let flows = flows_of(estimator, false, &frames);
        for (number, pair) in frames.windows(2).enumerate() {
            let expected = estimator.estimate(&pair[0], &pair[1]).expect("flow");
            assert_near(&flows[number], &expected, "in a sequence");
        }
        let warm = flows_of(estimator, true, &frames);
        assert_near(&warm[0], &flows[0], "nothing to start from");
        assert!(warm[1] != flows[1], "each tile starts from its own flow");
    }
}

fn until_still(network: &Network, still_px: f32) -> NetworkEstimator {
    let iterations = Iterations::UntilStill { still_px };
    NetworkEstimator::new("raft-small", network.clone(), iterations, Device::flex())
}

/// Nothing moves by a thousand pixels, least of all between a frame and itself.
#[test]
fn a_still_pair_takes_two_iterations() {
    let network = network();
    let frame = frame(136, 128, 0);
    let found = until_still(&network, 1000.0).estimate_pairs(&[[&frame, &frame]]).expect("flow").remove(0);
    let two = NonZeroUsize::new(2).expect("some");
    let fixed = NetworkEstimator::new("two", network, two, Device::flex());
    assert_eq!(found, fixed.estimate_pairs(&[[&frame, &frame]]).expect("flow").remove(0));
    assert_eq!(found.iterations, Some(2.0));
}

/// Alone, in a batch, along a video, and in tiles, of which the mean number is given.
#[test]
fn a_pair_takes_as_many_iterations_as_it_needs_whatever_its_mates() {
    let network = network();
    let frames = [0, 0, 3, 4].map(|number| frame(200, 128, number));
    let pairs: Vec<[&Image; 2]> = frames.windows(2).map(|pair| [&pair[0], &pair[1]]).collect();
    // The limit that the changes of the first two iterations reach: the mean, or a quarter of what one pixel in a hundred exceeds.
    let limit = |changes: Vec<[f32; 2]>| -> f32 {
        let mut lengths: Vec<f32> = changes.into_iter().map(|[u, v]| u.hypot(v)).collect();
        lengths.sort_by(|a, b| b.total_cmp(a));
        let mean = lengths.iter().sum::<f32>() / lengths.len() as f32;
        (lengths[lengths.len() / 100] / 4.0).max(mean)
    };
    let moved = |[first, second]: &[&Image; 2]| -> f32 {
        let flow = |iterations| {
            let pair = Frames { first: tensor(first), second: tensor(second) };
            field(network.forward(pair, &Request::new(iterations)).coarse.expect("a coarse flow") * 8.0)
        };
        let (one, two) = (flow(1), flow(2));
        let changes =
            two.pixels().iter().zip(one.pixels()).map(|(to, from)| [to[0] - from[0], to[1] - from[1]]);
        limit(one.pixels().to_vec()).max(limit(changes.collect()))
    };
    let moved: Vec<f32> = pairs.iter().map(moved).collect();
    let [least, most] = [f32::min, f32::max].map(|of| moved.iter().copied().reduce(of).expect("some"));
    let still_px = 0.5 * (least + most);
    let estimator = until_still(&network, still_px);
    let of = |pair: [&Image; 2]| estimator.estimate_pairs(&[pair]).expect("flow").remove(0);
    let alone: Vec<FlowEstimate> = pairs.iter().map(|pair| of(*pair)).collect();
    let default = network.architecture().facts().iterations.default as f32;
    for (estimate, moved) in alone.iter().zip(&moved) {
        let number = estimate.iterations.expect("some");
        assert!((2.0..=default).contains(&number), "{number} of {default}");
        assert_eq!(number == 2.0, *moved < still_px, "{number}: {moved} px, still below {still_px}");
    }
    assert_eq!(estimator.estimate_pairs(&pairs).expect("flows"), alone, "in a batch");
    assert_eq!(estimator.sequence(false).push(&frames).expect("flows"), alone, "along a video");
    let tiled = Wrapped::new(Box::new(until_still(&network, still_px))).tiled(tiling(128, 128, 48));
    let tiles = [0, 72].map(|left| pairs[1].map(|frame| frame.crop(left, 0, 128, 128)));
    let mean = tiles.map(|pair| of(pair.each_ref()).iterations.expect("some")).iter().sum::<f32>() / 2.0;
    for found in [tiled.estimate_pairs(&pairs), tiled.sequence(false).push(&frames)] {
        assert_eq!(found.expect("flows")[1].iterations, Some(mean), "in tiles");
    }
}

/// The mean of both scales, weighted by the softmax of the log weights, computed for each pixel in `f64`.
#[test]
fn a_mixture_becomes_the_uncertainty_of_the_flow() {
    // Random parameters, scaled up: as training starts, all scales are near 1 pixel.
    let network = Architecture::SeaRaftS.init(&Device::flex());
    let mut values = parameters(&network);
    let bias = TensorData::new(vec![0.0_f32, 0.0, 1.0, -1.0, 12.0, -2.0], [6]);
    values.insert("flow_head.2.bias".into(), bias);
    let network = with_parameters(network, values).expect("its own names and shapes");
    let frames = video(140, 131, 3);
    let Size { width, height } = frames[0].size();
    let expected: Vec<Plane> = (0..2)
        .map(|n| {
            let pair = Frames { first: tensor(&frames[n]), second: tensor(&frames[n + 1]) };
            let mixture = network.forward(pair, &Request::new(ITERATIONS)).mixtures.pop().expect("a mixture");
            let numbers = |tensor: Tensor<4>| -> Vec<f64> { tensor.into_data().iter::<f64>().collect() };
            let (weights, scales) = (numbers(mixture.log_weights), numbers(mixture.log_scales));
            Plane::from_fn(width, height, |x, y| {
                let at = y * width + x;
                let weights = [weights[at], weights[width * height + at]].map(f64::exp);
                let scales = [scales[at].clamp(0.0, 10.0).exp(), 1.0];
                ((weights[0] * scales[0] + weights[1] * scales[1]) / (weights[0] + weights[1])) as f32
            })
        })
        .collect();
    let named =
        NetworkEstimator::new("s", network, NonZeroUsize::new(ITERATIONS).expect("some"), Device::flex());
    let tiled = Wrapped::new(Box::new(named)).tiled(tiling(200, 200, 64));
    for at_once in [1, 3] {
        let mut sequence = tiled.sequence(false);
        let found: Vec<Plane> = frames
            .chunks(at_once)
            .flat_map(|frames| sequence.push(frames).expect("flows"))
            .map(|estimate| estimate.uncertainty.expect("a mixture"))
            .collect();
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(&expected) {
            let pairs = found.pixels().iter().zip(expected.pixels());
            let worst = pairs.map(|(found, expected)| (found / expected - 1.0).abs()).fold(0.0, f32::max);
            assert!(worst < 1e-3, "{at_once} at once: {worst} of the expected value");
            let (least, most) =
                expected.pixels().iter().fold((f32::MAX, 0.0_f32), |(a, b), v| (a.min(*v), b.max(*v)));
            assert!(least > 1.0 && most > 1.01 * least, "from {least} to {most} px");
        }
    }
    let without = estimator(&self::network()).sequence(false).push(&frames).expect("flows");
    assert!(without.iter().all(|estimate| estimate.uncertainty.is_none() && estimate.occlusion.is_none()));
}

struct Broken;

impl ModuleMapper for Broken {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|tensor| tensor * f32::NAN)
    }
}

#[test]
fn a_nan_flow_is_an_error() {
    let network = network().map(&mut Broken);
    let error = estimator(&network).estimate(&frame(128, 128, 0), &frame(128, 128, 1)).expect_err("NaN");
    assert!(error.to_string().contains("raft-small: computed NaN instead of a flow"), "{error}");
}

/// The weights that come with srflow: random ones would amplify what rounding changes.
#[test]
fn bfloat16_moves_a_trained_flow_little_and_the_same_way_in_a_sequence() {
    let device = Device::flex();
    let network = srflow_nets::load_included(Architecture::SrFlow, &device).expect("weights");
    let of = |precision| {
        let iterations = NonZeroUsize::new(2).expect("some");
        NetworkEstimator::new("srflow", network.clone(), iterations, device.clone()).with_precision(precision)
    };
    let frames = video(160, 120, 3);
    let exact = flows_of(&of(Precision::F32), false, &frames);
    let near = flows_of(&of(Precision::Bf16), false, &frames);
    for (pair, (exact, near)) in exact.iter().zip(&near).enumerate() {
        let lengths = exact.pixels().iter().zip(near.pixels()).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
        let mean = lengths.sum::<f32>() / exact.pixels().len() as f32;
        assert!(mean > 0.0 && mean < 0.02, "pair {pair}: {mean} px");
        let alone = of(Precision::Bf16).estimate(&frames[pair], &frames[pair + 1]).expect("a flow");
        assert_eq!(&alone, near, "pair {pair}");
    }
}

/// On the device of `SRFLOW_TEST_DEVICE`, at what it multiplies; see docs/guides/gpu.md.
#[test]
fn sixteen_bits_move_a_trained_flow_little_on_a_device() {
    let Ok(name) = std::env::var("SRFLOW_TEST_DEVICE") else {
        eprintln!("skipped: gpu: SRFLOW_TEST_DEVICE names no device");
        return;
    };
    let device = srflow_ops::device(&name).expect("the device of SRFLOW_TEST_DEVICE");
    let network = srflow_nets::load_included(Architecture::SrFlow, &device).expect("weights");
    let frames = video(160, 120, 2);
    let of = |precision| {
        let iterations = NonZeroUsize::new(2).expect("some");
        let estimator = NetworkEstimator::new("srflow", network.clone(), iterations, device.clone());
        estimator.with_precision(precision).estimate(&frames[0], &frames[1]).expect("a flow")
    };
    let exact = of(Precision::F32);
    for precision in srflow_ops::precisions(&device) {
        let near = of(precision);
        let lengths = exact.pixels().iter().zip(near.pixels()).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
        let mean = lengths.sum::<f32>() / exact.pixels().len() as f32;
        let limit = if precision == Precision::F16 { 0.005 } else { 0.02 };
        assert!(
            mean < limit && (mean > 0.0) == (precision != Precision::F32),
            "{}: {mean} px",
            precision.name()
        );
    }
}
