//! Features of a frame can be reused for both of its pairs.

use burn::tensor::{Device, Distribution, Tensor};
use srflow_nets::{Architecture, Features, Frames, Request};
use srflow_ops::golden::numbers;

/// Two pairs at once, of a size that needs padding; the features of each frame are computed separately.
#[test]
fn precomputed_features_give_the_same_flow() {
    for architecture in [Architecture::RaftSmall, Architecture::RpkNet] {
        check(architecture);
    }
}

fn check(architecture: Architecture) {
    let device = Device::flex();
    let network = architecture.init(&device);
    let video = Tensor::<4>::random([3, 3, 125, 133], Distribution::Uniform(0.0, 1.0), &device);
    let frames = Frames { first: video.clone().narrow(0, 0, 2), second: video.clone().narrow(0, 1, 2) };
    let known: Vec<Features> = (0..3).map(|n| network.features(video.clone().narrow(0, n, 1))).collect();
    let known = Features::cat(known);
    assert_eq!(known.frames(), 3);
    let features = Some([known.clone().narrow(0, 2), known.narrow(1, 2)]);

    let expected = network.forward(frames.clone(), &Request::new(3));
    let found = network.forward(frames.clone(), &Request { features: features.clone(), ..Request::new(3) });
    let (expected, found) = (numbers(expected.last().clone()), numbers(found.last().clone()));
    let difference = expected.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let largest = expected.iter().copied().fold(0.0, |largest: f32, value| largest.max(value.abs()));
    assert!(
        difference <= 1e-4 && largest > 0.01,
        "{architecture:?}: differ by {difference} px of {largest} px"
    );

    let swapped = features.map(|[first, second]| [second, first]);
    let other = network.forward(frames, &Request { features: swapped, ..Request::new(3) });
    assert!(numbers(other.last().clone()) != expected, "swapped features change the flow");
}
