//! The colour wheel matches pictures of `flow_vis` (`tools/golden/files.py`).

use std::path::PathBuf;

use srflow_core::{FlowField, Image, flow_colors, longest_flow};
use srflow_files::{read_flow, read_image};

fn data(name: &str) -> PathBuf {
    PathBuf::from("tests/data").join(name)
}

/// The arctangents of two libraries may differ in the last bit, and then a channel by one level.
fn assert_same_colors(ours: &Image, golden: &Image) {
    assert_eq!(ours.size(), golden.size());
    let ours = ours.pixels().as_flattened();
    let golden = golden.pixels().as_flattened();
    let differing = ours.iter().zip(golden).filter(|(a, b)| a != b).count();
    assert!(ours.iter().zip(golden).all(|(a, b)| a.abs_diff(*b) <= 1));
    assert!(differing * 200 <= ours.len(), "{differing} of {} channels differ", ours.len());
}

#[test]
fn colors_are_those_of_flow_vis() {
    let disc = read_flow(&data("disc.npy")).unwrap();
    assert_same_colors(&flow_colors(&disc, None), &read_image(&data("disc_flow_vis.png")).unwrap());
    assert_same_colors(
        &flow_colors(&disc, Some(2.5)),
        &read_image(&data("disc_flow_vis_max2.5.png")).unwrap(),
    );
}

#[test]
fn no_motion_is_white_and_unknown_is_black() {
    let mut flow = FlowField::new(3, 1);
    flow.set(1, 0, [f32::NAN; 2]);
    assert_eq!(flow_colors(&flow, None).pixels(), [[255; 3], [0; 3], [255; 3]]);
    assert_eq!(longest_flow(&flow), 0.0);
    assert_eq!(longest_flow(&FlowField::filled(2, 2, [f32::NAN; 2])), 0.0);
}

#[test]
fn the_longest_flow_has_full_saturation_whatever_its_length() {
    for length in [1e-3_f32, 1.0, 300.0, 1e8] {
        let flow = FlowField::from_pixels(2, 1, vec![[length, 0.0], [0.0, 0.0]]).unwrap();
        let [r, g, b] = flow_colors(&flow, None).get(0, 0);
        assert!(r == 255 && g < 10 && b < 10, "{length}: {r} {g} {b}");
    }
}
