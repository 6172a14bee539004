//! A method of your own, here the motion of the whole picture, compared with the built-in network on one pair with its true flow:
//!
//!     cargo run --release -p srflow --example own_method -- frame1.png frame2.png truth.flo

use std::error::Error;
use std::path::PathBuf;

use srflow::Watch;
use srflow::core::{EstimateError, FlowEstimator, FlowField, Image, Size, score};
use srflow::files::{read_flow, read_image};
use srflow::flow::{MethodParameters, MethodSpec, estimator};

/// The one translation, in whole pixels, after which the frames differ least.
struct Translation;

impl FlowEstimator for Translation {
    fn name(&self) -> &str {
        "translation"
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        let Size { width, height } = frame1.size();
        let difference = |u: isize, v: isize| {
            let inside = |x: usize, y: usize| {
                let (x, y) = (x.checked_add_signed(u)?, y.checked_add_signed(v)?);
                (x < width && y < height).then(|| frame2.get(x, y))
            };
            let pixels = (0..height).step_by(4).flat_map(|y| (0..width).step_by(4).map(move |x| (x, y)));
            let pairs = pixels.filter_map(|(x, y)| Some((frame1.get(x, y), inside(x, y)?)));
            let differences = pairs.map(|(a, b)| f64::from(a[1].abs_diff(b[1])));
            let (sum, count) = differences.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
            sum / f64::max(count, 1.0)
        };
        let shifts = (-8..=8).flat_map(|v| (-8..=8).map(move |u| (u, v)));
        let best = shifts.min_by(|a, b| difference(a.0, a.1).total_cmp(&difference(b.0, b.1)));
        let (u, v) = best.unwrap_or((0, 0));
        Ok(FlowField::filled(width, height, [u as f32, v as f32]))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [first, second, truth] = &paths[..] else {
        return Err("expected two pictures and a flow file".into());
    };
    let (first, second, truth) = (read_image(first)?, read_image(second)?, read_flow(truth)?);
    let network = estimator(&MethodSpec::default(), &MethodParameters::default(), &Watch::SILENT)?;
    for method in [&Translation as &dyn FlowEstimator, &*network] {
        let flow = method.estimate(&first, &second)?;
        match score(&flow, &truth, None)? {
            Some(metrics) => println!("{:12} end-point error {:.3} px", method.name(), metrics.epe),
            None => println!("{:12} no pixel has a true flow", method.name()),
        }
    }
    Ok(())
}
