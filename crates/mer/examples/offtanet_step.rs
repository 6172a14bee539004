//! Seconds of a training step of Off-TANet at batch 64, as folds take them:
//! `cargo run --release --example offtanet_step -- FOLDS STEPS`. FOLDS threads each train a network of their own, every
//! kernel on its fold's thread; with FOLDS 0, one network is trained with all threads (`RAYON_NUM_THREADS`) in its kernels.

use std::time::Instant;

use burn::tensor::{Device, Int, Tensor, TensorData};
use srflow_core::random::Key;
use srflow_mer::{Classifier, OffTaNet, Training, initialized};
use srflow_ops::ReusingAllocator;

/// As the program has it.
#[global_allocator]
static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();

const BATCH: usize = 64;

fn main() {
    let arguments: Vec<usize> = std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let [folds, steps] = arguments[..] else {
        eprintln!("usage: offtanet_step FOLDS STEPS");
        std::process::exit(2);
    };
    let mut seconds: Vec<f64> = if folds == 0 {
        train(steps)
    } else {
        let fold = || {
            let _pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
            train(steps)
        };
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..folds).map(|_| scope.spawn(fold)).collect();
            threads.into_iter().flat_map(|thread| thread.join().expect("a fold")).collect()
        })
    };
    seconds.sort_by(f64::total_cmp);
    println!("{:.4}", seconds[seconds.len() / 2]);
}

/// The seconds of each step, after one that warms up.
fn train(steps: usize) -> Vec<f64> {
    let device = Device::flex().autodiff();
    let mut training = Training::new(initialized::<OffTaNet>(&device, 3, Key::new(1), "timing"));
    let mut noise = Key::new(1).stream("input");
    let [channels, height, width] = OffTaNet::INPUT;
    let values: Vec<f32> = (0..BATCH * channels * height * width).map(|_| noise.uniform(-1.0, 1.0)).collect();
    let inputs: Tensor<4> =
        Tensor::from_data(TensorData::new(values, [BATCH, channels, height, width]), &device);
    let labels: Vec<i64> = (0..BATCH as i64).map(|clip| clip % 3).collect();
    let labels = Tensor::<1, Int>::from_data(labels.as_slice(), &device);
    let mut dropout = Key::new(1).stream("dropout");
    let mut step = || {
        let start = Instant::now();
        training.step(inputs.clone(), labels.clone(), 6.5e-4, Some(&mut dropout));
        start.elapsed().as_secs_f64()
    };
    step();
    (0..steps).map(|_| step()).collect()
}
