//! Preprocessing gives OpenCV's numbers. Golden data: `tools/golden/strain.py`.

use std::path::Path;

use srflow_core::resize::resize_cubic;
use srflow_core::{FlowField, Image, Plane};
use srflow_files::{Array, read_npy, read_npy_plane};
use srflow_mer::{StrainFormula, optical_strain};

fn golden(name: &str) -> std::path::PathBuf {
    Path::new("tests/data/preprocessing").join(name)
}

fn picture(name: &str) -> Image {
    let Array { shape, values } = read_npy(&golden(name)).unwrap();
    let [height, width, 3] = shape[..] else { panic!("{name}: {shape:?}") };
    let pixels = values.as_chunks::<3>().0.iter().map(|pixel| pixel.map(|value| value as u8)).collect();
    Image::from_pixels(width, height, pixels).unwrap()
}

fn difference(a: &Plane, b: &Plane) -> f32 {
    assert_eq!(a.size(), b.size());
    a.pixels().iter().zip(b.pixels()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn strain_is_opencvs_in_both_formulas() {
    let Array { shape, values } = read_npy(&golden("flow.npy")).unwrap();
    let flow = FlowField::from_pixels(shape[1], shape[0], values.as_chunks::<2>().0.to_vec()).unwrap();
    for (formula, name) in
        [(StrainFormula::Literature, "literature.npy"), (StrainFormula::OffTaNet, "off_tanet.npy")]
    {
        let expected = read_npy_plane(&golden(name)).unwrap();
        let worst = difference(&optical_strain(&flow, formula), &expected);
        assert!(worst < 2e-6, "{formula}: {worst}");
    }
}

#[test]
fn cubic_resizing_is_opencvs_to_the_last_bit() {
    let large = picture("picture.npy");
    for name in ["shrunk.npy", "grown.npy"] {
        let expected = picture(name);
        let resized = resize_cubic(&large, expected.size());
        assert_eq!(resized, expected, "{name}");
    }
}
