//! Measures attention between all pixels of a feature map, whole and within a tolerance:
//! `cargo run --release -p srflow-ops --example attention -- 150x200 bf16 0.001` (HEIGHTxWIDTH, precision, tolerance).
//!
//! 128 channels, as GMA and SKFlow have. The weights of a pixel fall with the distance from it as a Gaussian, of a width that is given as
//! a share of the image; the last row is attention that hardly depends on anything, as that of random parameters.

use std::time::Instant;

use burn::tensor::{Device, Distribution, Tensor, TensorData};
use srflow_ops::attention::tensor::Attention;
use srflow_ops::attention::with_attention_tolerance;
use srflow_ops::{Precision, ReusingAllocator, with_precision};

#[global_allocator]
static ALLOCATOR: ReusingAllocator = ReusingAllocator::new();

const CHANNELS: usize = 128;
/// What GMA and SKFlow keep.
const KEPT_BYTES: usize = 800 << 20;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [size, precision, tolerance] = arguments.as_slice() else {
        eprintln!("usage: attention HEIGHTxWIDTH f32|bf16 TOLERANCE");
        std::process::exit(2);
    };
    let (height, width) = size.split_once('x').expect("HEIGHTxWIDTH");
    let (height, width) = (height.parse().expect("height"), width.parse().expect("width"));
    let precision = if precision == "bf16" { Precision::Bf16 } else { Precision::F32 };
    let tolerance = tolerance.parse().expect("a tolerance");
    let device = Device::flex();
    let random =
        || Tensor::<4>::random([1, CHANNELS, height, width], Distribution::Uniform(-1.0, 1.0), &device);
    let values = random();
    println!("width     whole: prepare, gather    within {tolerance}: prepare, gather    largest difference");
    for share in [0.02, 0.05, 0.1, 0.2, f32::INFINITY] {
        let [queries, keys] =
            if share.is_finite() { near([height, width], share) } else { [random() * 0.1, random()] };
        let run = |tolerance| {
            with_precision(precision, || {
                with_attention_tolerance(tolerance, || {
                    let start = Instant::now();
                    let attention = Attention::new(queries.clone(), keys.clone(), KEPT_BYTES);
                    let prepared = start.elapsed().as_secs_f64();
                    let start = Instant::now();
                    let gathered = attention.gather(values.clone());
                    (prepared, start.elapsed().as_secs_f64(), gathered)
                })
            })
        };
        let (whole, within) = (run(0.0), run(tolerance));
        let difference = (whole.2 - within.2).abs().max().into_scalar::<f32>();
        println!(
            "{share:<5}     {:.3} s  {:.3} s               {:.3} s  {:.3} s                   {difference:.1e}",
            whole.0, whole.1, within.0, within.1
        );
    }
}

/// Queries and keys whose scores are `-distance^2 / (2 share^2)`, the sides of the image being 1, but for what is the same for all keys.
fn near([height, width]: [usize; 2], share: f32) -> [Tensor<4>; 2] {
    let pixels = height * width;
    let map = |of: &dyn Fn(usize, f32, f32) -> f32| {
        let mut numbers = vec![0.0; CHANNELS * pixels];
        for (at, number) in numbers.iter_mut().take(3 * pixels).enumerate() {
            let (channel, pixel) = (at / pixels, at % pixels);
            let (y, x) = ((pixel / width) as f32 / height as f32, (pixel % width) as f32 / width as f32);
            *number = of(channel, y, x);
        }
        Tensor::from_data(TensorData::new(numbers, [1, CHANNELS, height, width]), &Device::flex())
    };
    let precise = share.powi(-2);
    let queries = map(&|channel, y, x| precise * [y, x, -0.5][channel]);
    let keys = map(&|channel, y, x| [y, x, y * y + x * x][channel]);
    [queries, keys]
}
