//! The results match OpenCV's. Its flow was written by tools/parity/classical.py.

use std::path::{Path, PathBuf};

use srflow_classical::{Farneback, FarnebackParameters, TvL1, TvL1Parameters};
use srflow_core::{FlowEstimator, FlowField, Image, Size};
use srflow_files::{read_flow, read_image};

/// `(a, b, offset, half period, amplitude)` of triangle waves over positions in 1/256 pixel.
const WAVES: [[i64; 5]; 5] = [
    [5, 3, 100, 9000, 70],
    [-4, 7, 5000, 11000, 60],
    [9, -8, 0, 7000, 50],
    [2, 11, 900, 8000, 40],
    [13, 1, 70, 9500, 35],
];

/// The synthetic pair, by the rule of the script.
fn synthetic(frame: i64) -> Image {
    Image::from_fn(160, 120, |x, y| {
        let (x, y) = (x as i64, y as i64);
        let (at_x, at_y) = (256 * x - frame * (384 + 2 * y), 256 * y - frame * (x - 200));
        let wave = |[a, b, offset, half, amplitude]: [i64; 5]| {
            ((a * at_x + b * at_y + offset).rem_euclid(2 * half) - half).abs() * amplitude / half
        };
        [WAVES.into_iter().map(wave).sum::<i64>() as u8; 3]
    })
}

fn golden(name: &str) -> PathBuf {
    Path::new("tests/data").join(name)
}

/// Mean distance in pixels between `flow` and OpenCV's, which holds every `step`-th pixel.
fn distance(flow: &FlowField, name: &str, step: usize) -> f32 {
    let opencv = read_flow(&golden(&format!("{name}.npy"))).unwrap();
    let parts = Size::new(flow.width().div_ceil(step), flow.height().div_ceil(step));
    assert_eq!(opencv.size(), parts, "{name}");
    let mut sum = 0.0;
    for y in 0..opencv.height() {
        for x in 0..opencv.width() {
            let ([u, v], [cv_u, cv_v]) = (flow.get(x * step, y * step), opencv.get(x, y));
            sum += (u - cv_u).hypot(v - cv_v);
        }
    }
    sum / opencv.pixels().len() as f32
}

fn real_frame(name: &str) -> Option<Image> {
    let folder = Path::new("../../../shared/data/real-frames");
    if !folder.is_dir() {
        eprintln!("skipped: shared-data: no real frames in {}", folder.display());
        return None;
    }
    Some(read_image(&folder.join(name)).unwrap())
}

#[test]
fn the_synthetic_pair_moves_as_in_opencv() {
    let (first, second) = (synthetic(0), synthetic(1));
    let farneback = |parameters| Box::new(Farneback::new(parameters).unwrap()) as Box<dyn FlowEstimator>;
    let tvl1 = |parameters| Box::new(TvL1::new(parameters).unwrap()) as Box<dyn FlowEstimator>;
    let gaussian = FarnebackParameters {
        winsize: 15,
        poly_n: 7,
        poly_sigma: 1.5,
        pyr_scale: 0.6,
        gaussian: true,
        ..Default::default()
    };
    let gamma = TvL1Parameters { gamma: 0.3, median_filtering: 3, scale_step: 0.5, ..Default::default() };
    for (name, estimator, limit) in [
        ("synthetic_farneback", farneback(FarnebackParameters::default()), 1e-3),
        ("synthetic_farneback_gaussian", farneback(gaussian), 1e-3),
        ("synthetic_tvl1", tvl1(TvL1Parameters::default()), 0.05),
        ("synthetic_tvl1_gamma", tvl1(gamma), 0.05),
    ] {
        let distance = distance(&estimator.estimate(&first, &second).unwrap(), name, 8);
        assert!(distance < limit, "{name}: {distance} px");
    }
}

#[test]
fn real_frames_move_as_in_opencv() {
    let farneback = Farneback::new(FarnebackParameters::default()).unwrap();
    let tvl1 = TvL1::new(TvL1Parameters::default()).unwrap();
    for (name, first, second) in [
        ("sintel_16", "sintel/frame_0016.png", "sintel/frame_0017.png"),
        ("sintel_17", "sintel/frame_0017.png", "sintel/frame_0018.png"),
        ("kitti", "kitti/frame1.png", "kitti/frame2.png"),
    ] {
        let (Some(first), Some(second)) = (real_frame(first), real_frame(second)) else { return };
        let found = distance(&farneback.estimate(&first, &second).unwrap(), &format!("{name}_farneback"), 32);
        assert!(found < 0.005, "farneback, {name}: {found} px");
        let flow = tvl1.estimate(&first, &second).unwrap();
        if name == "kitti" {
            // The motion there is too large for TV-L1, and its errors are large and ill-defined.
            check_kitti_error(&flow);
        } else {
            let found = distance(&flow, &format!("{name}_tvl1"), 32);
            assert!(found < 0.05, "tvl1, {name}: {found} px");
        }
    }
}

/// The end-point error is no larger than that of OpenCV's TV-L1.
fn check_kitti_error(flow: &FlowField) {
    let folder = Path::new("../../../shared/data/real-frames");
    let truth = read_flow(&folder.join("kitti/flow_gt.png")).unwrap();
    let known = truth.pixels().iter().zip(flow.pixels()).filter(|([u, v], _)| u.is_finite() && v.is_finite());
    let errors: Vec<f64> = known.map(|([u, v], [x, y])| f64::from((x - u).hypot(y - v))).collect();
    let error = errors.iter().sum::<f64>() / errors.len() as f64;
    let opencv: f64 = std::fs::read_to_string(golden("kitti_tvl1_epe.txt")).unwrap().trim().parse().unwrap();
    assert!(error <= opencv, "{error} px, OpenCV {opencv} px");
}
