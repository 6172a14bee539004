//! Measures seconds per pair of frames with random parameters and frames:
//! `cargo run --release -p srflow-nets --example timing -- raft 512x800 32` (network, HEIGHTxWIDTH, iterations);
//! `raft@bf16` multiplies bfloat16.
//! With 0 iterations it uses the network's default. `RAYON_NUM_THREADS` sets the number of threads.
//!
//! More arguments, used by `tools/bench/nets.py`: repeats, weights, a file with both frames, and a file for the flow. The files
//! are raw `f32`, `[2, 3, height, width]` in 0..1 and `[2, height, width]`.

use std::path::Path;
use std::time::Instant;

use burn::tensor::{Device, Distribution, Tensor, TensorData};
use srflow_nets::{Architecture, Frames, Request, load_network};
use srflow_ops::{Precision, ReusingAllocator, with_precision};

#[global_allocator]
static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (network, size, iterations, rest) = match arguments.as_slice() {
        [network, size, iterations, rest @ ..] if matches!(rest.len(), 0 | 1 | 4) => {
            (network, size, iterations, rest)
        }
        _ => {
            eprintln!("usage: timing NETWORK HEIGHTxWIDTH ITERATIONS [REPEATS [WEIGHTS FRAMES FLOW]]");
            std::process::exit(2);
        }
    };
    let (height, width) = size.split_once('x').expect("HEIGHTxWIDTH");
    let shape = [1, 3, height.parse().expect("height"), width.parse().expect("width")];
    let (network, precision) = match network.split_once('@') {
        Some((network, "bf16")) => (network, Precision::Bf16),
        Some((_, other)) => panic!("{other}: bf16 or nothing"),
        None => (network.as_str(), Precision::F32),
    };
    let architecture = Architecture::from_name(network).expect("a network");
    let request = Request::new(match iterations.parse().expect("iterations") {
        0 => architecture.facts().iterations.default,
        iterations => iterations,
    });
    let repeats: usize = rest.first().map_or(3, |repeats| repeats.parse().expect("repeats"));
    let device = Device::flex();
    let mut network = architecture.init(&device);
    let frame = || Tensor::<4>::random(shape, Distribution::Uniform(0.0, 1.0), &device);
    let mut frames = Frames { first: frame(), second: frame() };
    if let [_, weights, pixels, _] = rest {
        network = load_network(architecture, Path::new(weights), &device).expect("weights");
        let bytes = std::fs::read(pixels).expect("frames");
        let numbers = bytes.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().expect("four")));
        let numbers: Vec<f32> = numbers.collect();
        let both = Tensor::from_data(TensorData::new(numbers, [2, 3, shape[2], shape[3]]), &device);
        frames = Frames { first: both.clone().narrow(0, 0, 1), second: both.narrow(0, 1, 1) };
    }
    for repeat in 0..repeats {
        let start = Instant::now();
        let estimate = with_precision(precision, || network.forward(frames.clone(), &request));
        println!("{:.4} s", start.elapsed().as_secs_f64());
        if let ([_, _, _, flow], true) = (rest, repeat + 1 == repeats) {
            let numbers: Vec<f32> = estimate.last().clone().into_data().try_to_vec().expect("f32");
            let bytes: Vec<u8> = numbers.into_iter().flat_map(f32::to_le_bytes).collect();
            std::fs::write(flow, bytes).expect("writing the flow");
        }
    }
}
