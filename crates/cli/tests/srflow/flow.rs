//! `srflow flow` as a user meets it: a pair, a sequence, and what is refused.

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::Value;
use srflow_field::{Image, flow_colors, read_flow, read_image, write_flow, write_image_png};

use crate::{fails, succeeds};

/// Frames show a smooth texture that moves by so many pixels to the right each.
const STEP: f64 = 2.0;
const SIZE: (usize, usize) = (96, 64);

fn frame(number: usize) -> Image {
    Image::from_fn(SIZE.0, SIZE.1, |x, y| {
        let (x, y) = (x as f64 - STEP * number as f64, y as f64);
        let grey =
            128.0 + 60.0 * (x * 0.21 + 0.8 * (y * 0.13).sin()).sin() + 50.0 * (y * 0.27 - x * 0.05).cos();
        [grey as u8; 3]
    })
}

fn write_frames(folder: &Path, numbers: impl IntoIterator<Item = usize>) {
    fs::create_dir_all(folder).unwrap();
    for number in numbers {
        write_image_png(&folder.join(format!("frame{number}.png")), &frame(number)).unwrap();
    }
}

fn flow(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = crate::srflow();
    command.current_dir(folder).args(["flow", "--method", "farneback"]).args(arguments).output().unwrap()
}

/// Mean of `u` and `v` away from the borders, where the frames show what was not there before.
fn mean_flow(file: &Path) -> [f64; 2] {
    let flow = read_flow(file).unwrap();
    assert_eq!(flow.size(), SIZE);
    let inner = (16..SIZE.1 - 16).flat_map(|y| (16..SIZE.0 - 16).map(move |x| (x, y)));
    let vectors: Vec<[f32; 2]> = inner.map(|(x, y)| flow.get(x, y)).collect();
    [0, 1].map(|axis| vectors.iter().map(|v| f64::from(v[axis])).sum::<f64>() / vectors.len() as f64)
}

fn assert_one_step(file: &Path) {
    let [u, v] = mean_flow(file);
    assert!((u - STEP).abs() < 0.1 && v.abs() < 0.1, "{}: ({u}, {v})", file.display());
}

#[test]
fn a_pair_gives_a_file_and_its_picture() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(dir, 0..2);
    let arguments = ["frame0.png", "frame1.png", "-o", "out/flow.npz", "--viz", "out/flow.png"];
    assert!(succeeds(&flow(dir, &arguments)).contains("out/flow.npz  96x64"));
    assert_one_step(&dir.join("out/flow.npz"));
    let colours = flow_colors(&read_flow(&dir.join("out/flow.npz")).unwrap(), None);
    assert_eq!(read_image(&dir.join("out/flow.png")).unwrap().pixels(), colours.pixels());

    fs::write(dir.join("out/flow.npz"), "mine").unwrap();
    let error = fails(&flow(dir, &arguments), 1);
    assert!(error.contains("out/flow.npz exists; give --force"), "{error}");
    assert_eq!(fs::read(dir.join("out/flow.npz")).unwrap(), b"mine");
    succeeds(&flow(dir, &[&arguments[..], &["--force"]].concat()));
    assert_one_step(&dir.join("out/flow.npz"));
}

#[test]
fn a_folder_gives_the_flows_between_its_frames_in_the_order_of_their_numbers() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(&dir.join("video"), 8..12);
    fs::write(dir.join("video/notes.txt"), "no frame").unwrap();
    fs::write(dir.join("video/._frame8.png"), "no frame").unwrap();
    let arguments = ["video", "-o", "flows", "--viz", "colours", "--format", "pfm", "--json"];
    let report: Value = serde_json::from_str(&succeeds(&flow(dir, &arguments))).unwrap();
    let pairs = report["pairs"].as_array().unwrap();
    let files: Vec<&str> = pairs.iter().map(|pair| pair["flow"].as_str().unwrap()).collect();
    assert_eq!(files, ["flows/frame8.pfm", "flows/frame9.pfm", "flows/frame10.pfm"]);
    for (file, pair) in files.iter().zip(pairs) {
        assert_one_step(&dir.join(file));
        assert_eq!(read_image(&dir.join(pair["viz"].as_str().unwrap())).unwrap().size(), SIZE);
    }
    succeeds(&flow(dir, &["video/frame8.png", "video/frame9.png", "video/frame10.png", "-o", "listed"]));
    assert_one_step(&dir.join("listed/frame9.flo"));
}

#[test]
fn what_cannot_be_done_is_said_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(dir, 0..3);
    write_image_png(&dir.join("wide.png"), &Image::from_fn(97, 64, |_, _| [9; 3])).unwrap();
    write_flow(&dir.join("other.flo"), &srflow_field::FlowField::new(5, 4)).unwrap();
    fs::write(dir.join("broken.png"), &fs::read(dir.join("frame1.png")).unwrap()[..200]).unwrap();
    fs::create_dir(dir.join("empty")).unwrap();
    let pair = ["frame0.png", "frame1.png"];
    let refused = |more: &[&str], code: i32, expected: &[&str]| {
        let error = fails(&flow(dir, more), code);
        assert!(expected.iter().all(|part| error.contains(part)), "{more:?}: {error}");
        assert!(!dir.join("new.flo").exists(), "{more:?}");
    };
    let with_pair = |more: &[&'static str]| [&pair[..], more].concat();
    refused(&["frame0.png", "wide.png", "-o", "new.flo"], 1, &["frame0.png is 96x64", "wide.png is 97x64"]);
    refused(&["frame0.png", "broken.png", "-o", "new.flo"], 1, &["broken.png: "]);
    refused(&["frame0.png", "absent.png", "-o", "new.flo"], 1, &["absent.png: "]);
    refused(&["frame0.png", "-o", "new.flo"], 2, &["one frame has no flow"]);
    refused(&["empty", "-o", "new"], 1, &["empty: expected two frames or more", "*.png", "found 0"]);
    refused(
        &["frame0.png", "frame1.png", "frame2.png", "-o", "new.flo"],
        2,
        &["new.flo: 3 frames give a folder of flows"],
    );
    refused(&with_pair(&["-o", "new.xyz"]), 2, &["new.xyz", "flo5"]);
    refused(
        &with_pair(&["-o", "frame0.png/new.flo"]),
        1,
        &["frame0.png: making the folder", "give the path of"],
    );
    refused(&with_pair(&["-o", "new.flo", "--viz", "new.jpg"]), 2, &["new.jpg", "ending in .png"]);
    refused(&with_pair(&["-o", "new.flo", "--viz", "empty"]), 2, &["empty", "ending in .png"]);
    refused(&with_pair(&["-o", "new.flo", "--viz", "new.png", "--viz-max", "0"]), 2, &["positive number"]);
    refused(
        &with_pair(&["-o", "new.flo", "--initial-flow", "other.flo"]),
        1,
        &["--initial-flow is 5x4", "96x64"],
    );
    refused(&with_pair(&["-o", "new.flo", "--threads", "0"]), 2, &["--threads"]);
    refused(&pair, 2, &["--out"]);
}
