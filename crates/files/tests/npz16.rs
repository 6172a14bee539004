//! The flow files of SRFlow datasets: accurate, small, and compatible with NumPy in both directions.

use std::fs;
use std::path::Path;

use proptest::prelude::*;
use srflow_core::FlowField;
use srflow_files::{FlowFormat, read_flow, write_flow};

fn again(flow: &FlowField) -> FlowField {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flow.npz16");
    write_flow(&path, flow).unwrap();
    read_flow(&path).unwrap()
}

fn greatest_error(a: &FlowField, b: &FlowField) -> f32 {
    assert_eq!(a.size(), b.size());
    let pairs = a.pixels().as_flattened().iter().zip(b.pixels().as_flattened());
    let error = |(a, b): (&f32, &f32)| {
        assert_eq!(a.is_nan(), b.is_nan());
        if a.is_nan() { 0.0 } else { (a - b).abs() }
    };
    pairs.map(error).fold(0.0, f32::max)
}

fn flows(reach: f32) -> impl Strategy<Value = FlowField> {
    let pixel = prop_oneof![4 => [-reach..reach, -reach..reach], 1 => Just([f32::NAN; 2])];
    (1_usize..12, 1_usize..12).prop_flat_map(move |(width, height)| {
        prop::collection::vec(pixel.clone(), width * height)
            .prop_map(move |pixels| FlowField::from_pixels(width, height, pixels).unwrap())
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_error_is_at_most_half_a_step(near in flows(127.9), far in flows(500.0)) {
        prop_assert!(greatest_error(&near, &again(&near)) <= 1.0 / 512.0);
        prop_assert!(greatest_error(&far, &again(&far)) <= 4.0 / 512.0);
    }

    #[test]
    fn read_values_survive_another_round_trip(flow in flows(3000.0)) {
        let once = again(&flow);
        prop_assert_eq!(greatest_error(&once, &again(&once)), 0.0);
    }

    #[test]
    fn broken_files_are_refused(flow in flows(50.0), at in 0.0_f64..1.0, bit in 0_u32..8) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flow.npz16");
        write_flow(&path, &flow).unwrap();
        let whole = fs::read(&path).unwrap();
        let at = (at * whole.len() as f64) as usize;
        fs::write(&path, &whole[..at]).unwrap();
        prop_assert!(read_flow(&path).is_err(), "cut at {} of {}", at, whole.len());
        let mut flipped = whole.clone();
        flipped[at] ^= 1 << bit;
        fs::write(&path, &flipped).unwrap();
        // Not every bit of a zip archive matters; a change of one that does must be detected.
        if let Ok(read) = read_flow(&path) {
            prop_assert!(greatest_error(&read, &flow) <= 1.0 / 512.0);
        }
    }
}

/// tools/golden/npz16.py wrote the file.
#[test]
fn a_file_of_numpys_is_read() {
    let path = Path::new("tests/data/numpy.npz16");
    let mut expected = FlowField::from_fn(7, 5, |x, y| {
        let (x, y) = (x as f32, y as f32);
        [x * x * 3.25 - y * 40.5, -0.00390625 * x * y]
    });
    expected.set(3, 2, [f32::NAN; 2]);
    expected.set(6, 4, [-300.0, expected.get(6, 4)[1]]);
    let read = read_flow(path).unwrap();
    assert!(greatest_error(&read, &expected) <= 1.0 / 128.0);
    assert_eq!(read.get(5, 0), [81.25, 0.0]);
}

#[test]
fn a_head_turning_takes_little() {
    let flow = FlowField::from_fn(440, 640, |x, y| {
        let (x, y) = (x as f32 / 220.0 - 1.0, y as f32 / 320.0 - 1.0);
        let inside = 1.0 - x * x - y * y;
        if inside > 0.0 { [12.0 * inside.sqrt() - 3.0 * y, 3.0 * x + (7.0 * y).sin()] } else { [0.0; 2] }
    });
    let folder = tempfile::tempdir().unwrap();
    let size = |format: FlowFormat| {
        let path = folder.path().join(format!("flow.{format}"));
        write_flow(&path, &flow).unwrap();
        fs::metadata(path).unwrap().len()
    };
    assert!(size(FlowFormat::Npz16) * 8 < size(FlowFormat::Flo));
    assert!(size(FlowFormat::Npz16) * 3 < size(FlowFormat::Npz));
    assert_eq!(read_flow(&folder.path().join("flow.npz16")).unwrap().size(), flow.size());
}

#[test]
fn values_beyond_every_step_are_reported() {
    let mut flow = FlowField::new(3, 2);
    flow.set(1, 1, [1e31, 0.0]);
    let folder = tempfile::tempdir().unwrap();
    let error = write_flow(&folder.path().join("flow.npz16"), &flow).unwrap_err().to_string();
    assert!(error.contains("flow.npz16: pixel (1, 1)"), "{error}");
}
