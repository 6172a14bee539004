use std::path::{Path, PathBuf};

use srflow_core::{FlowField, Image};
use srflow_files::{read_flow, read_image};

use super::color::Change;
use super::*;

/// Golden data: `tools/parity/augment.py`.
fn golden(name: &str) -> PathBuf {
    Path::new("tests/data/augment").join(name)
}

fn picture(name: &str) -> Image {
    read_image(&golden(&format!("{name}.png"))).expect("a golden picture")
}

/// Only scales: no flip, no crop.
fn scaled(width: usize, height: usize, scale: [f64; 2]) -> Geometry {
    let size = [width, height];
    let scaled = [0, 1].map(|i| (size[i] as f64 * scale[i]).round_ties_even() as usize);
    Geometry { size, scale, scaled, flip: [false; 2], corner: [0; 2], crop: scaled }
}

#[test]
fn colours_change_as_in_torchvision() {
    let cases = [
        ("brightness_0.62", vec![Change::Brightness(0.62)]),
        ("brightness_1.37", vec![Change::Brightness(1.37)]),
        ("contrast_0.61", vec![Change::Contrast(0.61)]),
        ("contrast_1.39", vec![Change::Contrast(1.39)]),
        ("saturation_0.63", vec![Change::Saturation(0.63)]),
        ("saturation_1.38", vec![Change::Saturation(1.38)]),
        ("hue_0.13", vec![Change::Hue(0.13)]),
        ("hue_-0.159", vec![Change::Hue(-0.159)]),
        ("hue_0.0", vec![Change::Hue(0.0)]),
        (
            "chain",
            vec![
                Change::Contrast(1.21),
                Change::Hue(-0.07),
                Change::Brightness(0.83),
                Change::Saturation(1.31),
            ],
        ),
    ];
    for (name, changes) in cases {
        let mut changed = picture("picture");
        ColorJitter(changes).apply(&mut [&mut changed], &HueTables::new());
        assert_ne!(changed, picture("picture"), "{name}");
        for (index, (found, expected)) in changed.pixels().iter().zip(picture(name).pixels()).enumerate() {
            assert_eq!(
                found,
                expected,
                "{name}: pixel {index}, {:?} before",
                picture("picture").pixels()[index]
            );
        }
    }
}

#[test]
fn frames_and_flows_scale_as_in_opencv() {
    for scale in [[1.37, 0.81], [0.55, 2.3]] {
        let name = format!("{}_{}", scale[0], scale[1]);
        let geometry = scaled(64, 48, scale);
        let (found, expected) = (geometry.frame(&picture("picture")), picture(&format!("scaled_{name}")));
        assert_eq!(found.size(), expected.size());
        let apart = |a: &Image, b: &Image| {
            let pairs = a.pixels().as_flattened().iter().zip(b.pixels().as_flattened());
            pairs.map(|(a, b)| a.abs_diff(*b)).max()
        };
        assert_eq!(apart(&found, &expected), Some(0), "{name}");
        let flow = read_flow(&golden("flow.npy")).expect("a golden flow");
        let expected: FlowField = read_flow(&golden(&format!("flow_{name}.npy"))).expect("a golden flow");
        let found = geometry.dense_flow(&flow);
        assert_eq!(found.size(), expected.size());
        for (found, expected) in found.pixels().iter().zip(expected.pixels()) {
            assert!((0..2).all(|c| (found[c] - expected[c]).abs() < 1e-4), "{found:?} for {expected:?}");
        }
    }
}
