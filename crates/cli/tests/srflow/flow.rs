//! `srflow flow`: a pair, a sequence, and refused input.

use std::fs;
use std::path::Path;
use std::process::Output;

use srflow_core::{Image, Size, flow_colors};
use srflow_files::{read_flow, read_image, write_flow, write_image_png};

use crate::frames::write_frames;
use crate::{json, notes, refuses, succeeds};

/// How far the waves move from frame to frame.
const STEP: f64 = 2.0;
const SIZE: Size = Size::new(96, 64);

fn flow(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = crate::srflow();
    command.current_dir(folder).args(["flow", "--method", "farneback"]).args(arguments).output().unwrap()
}

/// Mean of `u` and `v` away from the borders, where new texture enters.
fn mean_flow(file: &Path) -> [f64; 2] {
    let flow = read_flow(file).unwrap();
    assert_eq!(flow.size(), SIZE);
    let inner = (16..SIZE.height - 16).flat_map(|y| (16..SIZE.width - 16).map(move |x| (x, y)));
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
    write_frames(dir, 0..2, SIZE);
    let arguments = ["0.png", "1.png", "-o", "out/flow.npz", "--viz", "out/flow.png"];
    assert!(succeeds(&flow(dir, &arguments)).contains("out/flow.npz  96x64"));
    assert_one_step(&dir.join("out/flow.npz"));
    let colours = flow_colors(&read_flow(&dir.join("out/flow.npz")).unwrap(), None);
    assert_eq!(read_image(&dir.join("out/flow.png")).unwrap().pixels(), colours.pixels());

    fs::write(dir.join("out/flow.npz"), "mine").unwrap();
    refuses(&flow(dir, &arguments), 1, &["out/flow.npz exists; give --force"]);
    assert_eq!(fs::read(dir.join("out/flow.npz")).unwrap(), b"mine");
    succeeds(&flow(dir, &[&arguments[..], &["--force"]].concat()));
    assert_one_step(&dir.join("out/flow.npz"));
}

#[test]
fn a_folder_gives_the_flows_between_its_frames_in_the_order_of_their_numbers() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(&dir.join("video"), 8..12, SIZE);
    fs::write(dir.join("video/notes.txt"), "no frame").unwrap();
    fs::write(dir.join("video/._8.png"), "no frame").unwrap();
    let arguments = ["video", "-o", "flows", "--viz", "colours", "--format", "pfm", "--json"];
    let report = json(&flow(dir, &arguments));
    let pairs = report["pairs"].as_array().unwrap();
    let files: Vec<&str> = pairs.iter().map(|pair| pair["flow"].as_str().unwrap()).collect();
    assert_eq!(files, ["flows/8.pfm", "flows/9.pfm", "flows/10.pfm"]);
    for (file, pair) in files.iter().zip(pairs) {
        assert_one_step(&dir.join(file));
        assert_eq!(read_image(&dir.join(pair["viz"].as_str().unwrap())).unwrap().size(), SIZE);
    }
    succeeds(&flow(dir, &["video/8.png", "video/9.png", "video/10.png", "-o", "listed"]));
    assert_one_step(&dir.join("listed/9.flo"));
}

#[test]
fn the_names_of_frames_say_their_order() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(&dir.join("given"), 0..3, SIZE);
    let folder = |name: &str, stems: &[&str]| {
        fs::create_dir(dir.join(name)).unwrap();
        for (at, stem) in stems.iter().enumerate() {
            let given = dir.join(format!("given/{}.png", at.min(2)));
            fs::copy(given, dir.join(format!("{name}/{stem}.png"))).unwrap();
        }
    };
    let flows = |name: &str| {
        let out = format!("{name}-flow");
        let output = flow(dir, &[name, "-o", &out]);
        let said = notes(&output);
        for file in fs::read_dir(dir.join(&out)).unwrap() {
            assert_one_step(&file.unwrap().path());
        }
        (fs::read_dir(dir.join(out)).unwrap().count(), said)
    };
    folder("times", &["1305031102.175304", "1305031102.211214", "1305031102.243211"]);
    folder("signs", &["t-1", "t0", "t1"]);
    folder("rate", &["f46_200fps", "f47_200fps", "f48_200fps"]);
    for name in ["times", "signs", "rate"] {
        assert_eq!(flows(name), (2, String::new()), "{name}");
    }
    folder("copy", &["1", "2", "3", "2 (1)"]);
    let (count, said) = flows("copy");
    assert!(
        count == 2 && said.contains("2 (1).png: left out, since its name is that of a copy of 2"),
        "{said}"
    );
    folder("twice", &["1", "01", "2"]);
    refuses(&flow(dir, &["twice", "-o", "new"]), 1, &["twice: one frame exists twice, as 01.png and 1.png"]);
    folder("other", &[]);
    fs::write(dir.join("other/1.gif"), "").unwrap();
    refuses(&flow(dir, &["other", "-o", "new"]), 1, &["found 0, and 1 .gif file", "convert to PNG"]);
    fs::write(dir.join("a.xyz"), "").unwrap();
    refuses(&flow(dir, &["none", "-o", "new"]), 2, &["none: expected frames", "no such file or folder"]);
    refuses(
        &flow(dir, &["a.xyz", "-o", "new"]),
        2,
        &["a.xyz: expected two frames", ".mts", "another ending"],
    );
}

#[test]
fn impossible_requests_are_explained_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(dir, 0..3, SIZE);
    write_image_png(&dir.join("wide.png"), &Image::from_fn(97, 64, |_, _| [9; 3])).unwrap();
    write_flow(&dir.join("other.flo"), &srflow_core::FlowField::new(5, 4)).unwrap();
    fs::write(dir.join("broken.png"), &fs::read(dir.join("1.png")).unwrap()[..200]).unwrap();
    fs::create_dir(dir.join("empty")).unwrap();
    let pair = ["0.png", "1.png"];
    let refused = |more: &[&str], code: i32, expected: &[&str]| {
        refuses(&flow(dir, more), code, expected);
        assert!(!dir.join("new.flo").exists(), "{more:?}");
    };
    let with_pair = |more: &[&'static str]| [&pair[..], more].concat();
    refused(&["0.png", "wide.png", "-o", "new.flo"], 1, &["0.png is 96x64", "wide.png is 97x64"]);
    refused(&["0.png", "broken.png", "-o", "new.flo"], 1, &["broken.png: "]);
    refused(&["0.png", "absent.png", "-o", "new.flo"], 1, &["absent.png: "]);
    refused(&["0.png", "-o", "new.flo"], 2, &["one frame has no flow"]);
    refused(&["empty", "-o", "new"], 1, &["empty: expected two frames or more", "*.png", "found 0"]);
    refused(
        &["0.png", "1.png", "2.png", "-o", "new.flo"],
        2,
        &["new.flo: 3 frames give a folder of flow files"],
    );
    refused(&with_pair(&["-o", "new.xyz"]), 2, &["new.xyz", "flo5"]);
    refused(&with_pair(&["-o", "0.png/new.flo"]), 1, &["0.png: making the folder", "give the path of"]);
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
