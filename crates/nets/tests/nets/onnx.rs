//! Every network that is written as ONNX, as onnxruntime runs it, against the network itself.
//!
//! They need a Python with numpy, onnx and onnxruntime: `python3`, or the one that `SRFLOW_PYTHON` names.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::Command;

use burn::tensor::{Device, Tensor, TensorData};
use srflow_core::{FlowEstimator, FlowField, Image, Size};
use srflow_nets::{
    Architecture, Frames, Network, NetworkEstimator, OnnxOptions, Request, Start, load_included,
    save_network_onnx,
};
use srflow_ops::golden::{Golden, numbers};

use crate::inputs::{filled, frame};

const ITERATIONS: NonZeroUsize = NonZeroUsize::new(2).unwrap();
/// Pixels, of flow and of uncertainty.
const LIMIT: f32 = 1e-3;
/// Padded by odd numbers of pixels; below the smallest side of RAFT in both directions; not padded. The first two by the same file.
const SIZES: [(Size, bool); 4] = [
    (Size::new(150, 133), false),
    (Size::new(90, 50), false),
    (Size::new(150, 133), true),
    (Size::new(160, 128), true),
];

fn network(architecture: Architecture) -> Network {
    let device = Device::flex();
    load_included(architecture, &device).unwrap_or_else(|| {
        let golden = format!("tests/golden/{}_1x128x160.safetensors", architecture.name().replace('-', "_"));
        filled(architecture.init(&device), &Golden::read(golden))
    })
}

/// RGB in 0..255.
fn image(Size { width, height }: Size, shift: i64) -> Image {
    let values = numbers(frame([1, height, width], shift, &Device::flex()));
    Image::from_fn(width, height, |x, y| {
        [0, 1, 2].map(|channel| (255.0 * values[(channel * height + y) * width + x]).round() as u8)
    })
}

fn channels(image: &Image) -> Vec<f32> {
    (0..3).flat_map(|channel| image.pixels().iter().map(move |pixel| f32::from(pixel[channel]))).collect()
}

fn planes(flow: &FlowField) -> Vec<f32> {
    (0..2).flat_map(|axis| flow.pixels().iter().map(move |vector| vector[axis])).collect()
}

/// Neither constant nor the same in both directions.
fn start_flow(Size { width, height }: Size) -> FlowField {
    FlowField::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32, y as f32);
        [3.0 + (0.11 * x).sin() + 0.01 * y, 1.5 - 0.008 * x + 0.7 * (0.07 * y).cos()]
    })
}

/// The means of a flow in the cells of a padded frame, in cells.
fn in_cells(flow: &FlowField, multiple: usize, stride: usize) -> Tensor<4> {
    let sides = [flow.height(), flow.width()];
    let padded = sides.map(|side| side.next_multiple_of(multiple));
    let [height, width] = padded.map(|side| side / stride);
    let inside =
        |at: usize, axis: usize| at.saturating_sub((padded[axis] - sides[axis]) / 2).min(sides[axis] - 1);
    let mean = |component: usize, row: usize, column: usize| {
        let pixels = (0..stride * stride).map(|at| {
            let (y, x) = (row * stride + at / stride, column * stride + at % stride);
            flow.get(inside(x, 1), inside(y, 0))[component]
        });
        pixels.sum::<f32>() / (stride * stride * stride) as f32
    };
    let cells = (0..2 * height * width).map(|at| {
        let cell = at % (height * width);
        mean(at / (height * width), cell / width, cell % width)
    });
    Tensor::from_data(TensorData::new(cells.collect::<Vec<f32>>(), [1, 2, height, width]), &Device::flex())
}

/// Inputs and outputs of a network for frames of this size, by the names in its file.
fn expected(network: &Network, size: Size) -> BTreeMap<&'static str, Vec<f32>> {
    let facts = network.architecture().facts();
    let [first, second] = [0, 4].map(|shift| image(size, shift));
    let estimator = NetworkEstimator::new("network", network.clone(), ITERATIONS, Device::flex());
    let mut found = BTreeMap::from([("frame1", channels(&first)), ("frame2", channels(&second))]);
    if !facts.mixture {
        found.insert("flow", planes(&estimator.estimate(&first, &second).unwrap()));
        return found;
    }
    let start = start_flow(size);
    let flow = estimator.estimate_from(&first, &second, &start).unwrap().flow;
    // Below the smallest side the estimator pads before the network does.
    if size.width.min(size.height) >= facts.smallest_side {
        let Start::Coarse(stride) = facts.start else { panic!("starts from a coarse flow") };
        let coarse = in_cells(&start, facts.padding, stride);
        let request = Request { start: Some(coarse), ..Request::new(ITERATIONS.get()) };
        let frame = |image| {
            let shape = [1, 3, size.height, size.width];
            Tensor::<4>::from_data(TensorData::new(channels(image), shape), &Device::flex()) / 255.0
        };
        let estimate = network.forward(Frames { first: frame(&first), second: frame(&second) }, &request);
        let of_tensor = numbers(estimate.last().clone());
        let far = |(a, b): (&f32, f32)| (a - b).abs();
        assert!(of_tensor.iter().zip(planes(&flow)).map(far).all(|far| far < 1e-4), "the same start");
        let mixture = estimate.mixtures.last().unwrap();
        found.insert("uncertainty", numbers(mixture.mean_scale(facts.log_scale_range)));
    }
    found.insert("flow", planes(&flow));
    found.insert("start", planes(&start));
    found
}

/// The lines that `onnx_runtime.py` prints of these cases; `None` when it cannot run.
fn run(cases: &[[String; 3]]) -> Option<String> {
    let python = std::env::var("SRFLOW_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let ready = Command::new(&python).args(["-c", "import numpy, onnx, onnxruntime"]).output();
    if !ready.is_ok_and(|ready| ready.status.success()) {
        eprintln!("skipped: onnx: {python} lacks numpy, onnx or onnxruntime; set SRFLOW_PYTHON");
        return None;
    }
    let ran = Command::new(&python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/onnx_runtime.py"))
        .args(cases.as_flattened())
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success() && errors.is_empty(), "{errors}");
    Some(String::from_utf8(ran.stdout).unwrap())
}

#[test]
fn onnxruntime_gives_the_flow_of_each_network() {
    let folder = tempfile::tempdir().unwrap();
    let exported: Vec<Architecture> =
        Architecture::ALL.into_iter().filter(|architecture| architecture.exports_to_onnx()).collect();
    assert!(exported.len() >= 4, "{exported:?}");
    let (mut cases, mut compared) = (Vec::new(), BTreeMap::new());
    for architecture in exported {
        let network = network(architecture);
        for (size, fixed) in SIZES {
            let name = architecture.name();
            let file = if fixed { format!("{name} {size}.onnx") } else { format!("{name}.onnx") };
            let file = folder.path().join(file);
            if !file.exists() {
                let options = OnnxOptions { iterations: ITERATIONS, size: fixed.then_some(size) };
                save_network_onnx(&network, options, &file).unwrap();
            }
            let data = folder.path().join(cases.len().to_string());
            fs::create_dir(&data).unwrap();
            let mut network = network.clone();
            if !fixed {
                // Graphs for any size have nothing that only small frames get.
                _ = network.set("fine_up_to", 0);
            }
            for (tensor, numbers) in expected(&network, size) {
                let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
                fs::write(data.join(tensor), bytes).unwrap();
                if !["frame1", "frame2", "start"].contains(&tensor) {
                    let largest = numbers.iter().fold(0.0, |largest: f32, number| largest.max(number.abs()));
                    let of_file = if fixed { size.to_string() } else { "any".to_owned() };
                    compared.insert(format!("{name} {of_file} {size} {tensor}"), largest);
                }
            }
            cases.push([file.display().to_string(), data.display().to_string(), size.to_string()]);
        }
    }
    let Some(printed) = run(&cases) else { return };
    let differences: BTreeMap<&str, f32> = printed
        .lines()
        .map(|line| {
            let (what, difference) = line.rsplit_once(' ').unwrap_or_else(|| panic!("{line}"));
            (what, difference.parse().expect(line))
        })
        .collect();
    for (what, largest) in compared {
        let found = differences.get(&*what).unwrap_or_else(|| panic!("{what} is missing in {printed}"));
        println!("{what}: up to {largest:.2}, difference {found:.1e}");
        assert!(largest > 0.1, "{what}: a flow near zero compares nothing");
        assert!(*found < LIMIT, "{what}: {found} px");
    }
}
