//! Seconds per pair of frames: `cargo run --release -p srflow-nets --example timing -- raft 512x800 32`
//! (HEIGHTxWIDTH, iterations). Threads: `RAYON_NUM_THREADS`.

use std::time::Instant;

use burn::tensor::{Device, Distribution, Tensor};
use srflow_nets::{Architecture, Frames, Request};
use srflow_ops::ReusingAllocator;

#[global_allocator]
static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [network, size, iterations] = arguments.as_slice() else {
        eprintln!("usage: timing raft|raft-small|gma|skflow HEIGHTxWIDTH ITERATIONS");
        std::process::exit(2);
    };
    let (height, width) = size.split_once('x').expect("HEIGHTxWIDTH");
    let shape = [1, 3, height.parse().expect("height"), width.parse().expect("width")];
    let request = Request::new(iterations.parse().expect("iterations"));
    let device = Device::flex();
    let network = Architecture::from_name(network).expect("a network").init(&device);
    let frame = || Tensor::<4>::random(shape, Distribution::Uniform(0.0, 1.0), &device);
    let frames = Frames { first: frame(), second: frame() };
    for _ in 0..3 {
        let start = Instant::now();
        drop(network.forward(frames.clone(), &request));
        println!("{:.2} s", start.elapsed().as_secs_f64());
    }
}
