//! `srflow flow` and `srflow eval` with networks, as a user meets them. The weights are random: what they give is no flow
//! of anything, but the same every time.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use burn::tensor::Device;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;
use srflow_field::{FlowField, Image, read_flow, read_image, write_flow, write_image_png};
use srflow_nets::Architecture;
use srflow_nn::parameter_infos;

use crate::{fails, succeeds};

const SIZE: (usize, usize) = (150, 133);

fn frame(number: usize) -> Image {
    Image::from_fn(SIZE.0, SIZE.1, |x, y| {
        let (x, y) = (x as f64 - 2.0 * number as f64, y as f64);
        let grey = 128.0 + 60.0 * (x * 0.21 + 0.8 * (y * 0.13).sin()).sin() + 50.0 * (y * 0.27).cos();
        [grey as u8, (255.0 - grey) as u8, (x * y) as u8]
    })
}

/// Random weights of RAFT-S whose variance keeps activations their size.
fn write_weights(path: &Path, seed: u32) {
    let mut state = seed;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    };
    let infos = parameter_infos(&Architecture::RaftSmall.init(&Device::flex()));
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = infos
        .into_iter()
        .map(|info| {
            let fan_in: usize = info.shape[1..].iter().product();
            let scale = if info.shape.len() > 1 { (3.0 / fan_in as f32).sqrt() } else { 0.1 };
            let count: usize = info.shape.iter().product();
            let bytes = (0..count).flat_map(|_| (scale * noise()).to_le_bytes()).collect();
            (info.name, info.shape, bytes)
        })
        .collect();
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    fs::write(path, safetensors::serialize(views, None).unwrap()).unwrap();
}

/// A folder with six frames and two files of weights.
fn data() -> &'static Path {
    static DATA: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = DATA.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().to_owned();
        fs::create_dir(path.join("video")).unwrap();
        for number in 0..6 {
            write_image_png(&path.join(format!("video/{number}.png")), &frame(number)).unwrap();
        }
        write_weights(&path.join("one.safetensors"), 1);
        write_weights(&path.join("two.safetensors"), 2);
        (dir, path)
    });
    path
}

fn srflow(arguments: &[&str]) -> Output {
    crate::srflow().current_dir(data()).args(arguments).output().unwrap()
}

/// `srflow flow` with RAFT-S, two iterations.
fn flow(more: &[&str]) -> Output {
    let raft = ["flow", "--method", "raft-small", "--weights", "one.safetensors", "--iters", "2"];
    srflow(&[&raft, more].concat())
}

fn read(file: &str) -> FlowField {
    read_flow(&data().join(file)).unwrap()
}

/// Largest difference and largest value, in pixels.
fn compare(a: &FlowField, b: &FlowField) -> (f32, f32) {
    assert_eq!(a.size(), b.size());
    let pairs = a.pixels().as_flattened().iter().zip(b.pixels().as_flattened());
    pairs.fold((0.0, 0.0), |(far, long), (a, b)| ((a - b).abs().max(far), a.abs().max(long)))
}

#[test]
fn a_pair_gives_a_flow_and_a_report() {
    let arguments = ["video/0.png", "video/1.png", "-o", "pair/flow.flo", "--viz", "pair/flow.png", "--json"];
    let report: Value = serde_json::from_str(&succeeds(&flow(&arguments))).unwrap();
    assert_eq!(report["method"], "raft-small");
    assert_eq!(report["network"]["iterations"], 2);
    assert_eq!(report["network"]["device"], "cpu");
    assert_eq!(report["resolution"]["width"], 150);
    assert_eq!(report["resolution"]["tiles"], 1);
    assert_eq!(read("pair/flow.flo").size(), SIZE);
    assert_eq!(read_image(&data().join("pair/flow.png")).unwrap().size(), SIZE);
    let of_its_own = ["flow", "--method", "raft-small=one.safetensors", "--iters", "2", "-o", "pair/own.flo"];
    succeeds(&srflow(&[&of_its_own[..], &["video/0.png", "video/1.png"]].concat()));
    assert_eq!(read("pair/own.flo"), read("pair/flow.flo"));
}

/// However many pairs at once.
#[test]
fn a_folder_gives_what_its_pairs_give() {
    succeeds(&flow(&["video/2.png", "video/3.png", "-o", "alone.flo"]));
    for batch in ["1", "2", "4", "9"] {
        let out = format!("batch{batch}");
        let text = succeeds(&flow(&["video", "-o", &out, "--batch", batch]));
        assert_eq!(text.lines().count(), 5, "{text}");
        let (far, long) = compare(&read("alone.flo"), &read(&format!("{out}/2.flo")));
        assert!(far < 1e-3 && long > 0.1, "batch {batch}: {far} px of {long}");
    }
    succeeds(&flow(&["video", "-o", "warm", "--warm-start"]));
    assert_eq!(compare(&read("warm/0.flo"), &read("batch1/0.flo")).0, 0.0);
    assert!(compare(&read("warm/1.flo"), &read("batch1/1.flo")).0 > 0.01);
}

#[test]
fn large_frames_are_cut_or_scaled_and_the_report_says_how() {
    let resolution = |name: &str, more: &[&str]| {
        let out = format!("large/{name}.flo");
        let pair = ["video/0.png", "video/1.png", "-o", &out, "--json"];
        let report: Value = serde_json::from_str(&succeeds(&flow(&[&pair, more].concat()))).unwrap();
        assert_eq!(read(&out).size(), SIZE);
        let part = |key: &str| report["resolution"][key].as_u64().unwrap();
        [part("width"), part("height"), part("tile_width"), part("tile_height"), part("tiles")]
    };
    assert_eq!(resolution("whole", &[]), [150, 133, 150, 133, 1]);
    assert_eq!(resolution("auto", &["--tile", "auto"]), [150, 133, 150, 133, 1]);
    assert_eq!(compare(&read("large/auto.flo"), &read("large/whole.flo")).0, 0.0);
    assert_eq!(resolution("tiled", &["--tile", "128x128", "--tile-overlap", "32"]), [150, 133, 128, 128, 4]);
    assert_eq!(resolution("half", &["--scale", "0.5"]), [75, 67, 75, 67, 1]);
    assert_eq!(resolution("both", &["--scale", "2", "--tile", "200x300"]), [300, 266, 200, 266, 2]);
}

#[test]
fn what_is_wrong_is_said() {
    fs::write(data().join("broken.ckpt"), b"not a checkpoint at all").unwrap();
    let pair = ["video/0.png", "video/1.png", "-o", "never.flo"];
    let refused = |arguments: &[&str], code: i32, expected: &[&str]| {
        let error = fails(&srflow(&[&["flow"], arguments, &pair].concat()), code);
        assert!(expected.iter().all(|part| error.contains(part)), "{arguments:?}: {error}");
        assert!(!data().join("never.flo").exists(), "{arguments:?}");
    };
    refused(&["--method", "raft"], 2, &["raft needs weights", "--weights FILE", "srflow models"]);
    refused(&["--method", "pwc"], 2, &["there is no method `pwc`", "farneback, tvl1, raft"]);
    refused(&["--method", "tvl1=a.ckpt"], 2, &["tvl1 has no weights"]);
    refused(&["--method", "tvl1", "--iters", "5"], 2, &["--iters is for networks"]);
    refused(&["--method", "tvl1", "--tile", "auto"], 2, &["--tile auto is for networks"]);
    let with = |weights: &'static str, more: &[&'static str]| {
        [&["--method", "raft-small", "--weights", weights], more].concat()
    };
    refused(&with("nowhere.ckpt", &[]), 1, &["nowhere.ckpt"]);
    refused(&with("broken.ckpt", &[]), 1, &["broken.ckpt"]);
    refused(&["--method", "raft", "--weights", "one.safetensors"], 1, &["one.safetensors", "fnet"]);
    let one = "one.safetensors";
    refused(&with(one, &["--iters", "0"]), 2, &["--iters"]);
    refused(&with(one, &["--device", "gpu"]), 2, &["--device", "cpu, cuda, vulkan"]);
    refused(&with(one, &["--device", "cpu:7"]), 2, &["--device", "cpu:7"]);
    refused(&with(one, &["--tile", "64x64"]), 2, &["128 pixels"]);
    refused(&with(one, &["--tile", "large"]), 2, &["WIDTHxHEIGHT in pixels, or auto"]);
    refused(&with(one, &["--scale", "0"]), 2, &["factor"]);
    refused(&with(one, &["--warm-start", "--batch", "2"]), 2, &["--warm-start", "--batch"]);
}

#[test]
fn a_folder_of_two_sizes_is_refused_before_any_work() {
    let dir = data().join("sizes");
    fs::create_dir(&dir).unwrap();
    for number in 0..3 {
        let side = if number == 2 { 140 } else { 150 };
        write_image_png(&dir.join(format!("{number}.png")), &Image::new(side, 133)).unwrap();
    }
    let error = fails(&flow(&["sizes", "-o", "sized"]), 1);
    assert!(error.contains("sizes/0.png is 150x133") && error.contains("sizes/2.png is 140x133"), "{error}");
    assert!(!data().join("sized").exists());
}

#[test]
fn tables_name_networks_by_their_weights() {
    let dir = data().join("pairs");
    fs::create_dir(&dir).unwrap();
    for (name, number) in [("img1", 0), ("img2", 1)] {
        write_image_png(&dir.join(format!("p_{name}.png")), &frame(number)).unwrap();
    }
    write_flow(&dir.join("p_flow.flo"), &FlowField::filled(SIZE.0, SIZE.1, [2.0, 0.0])).unwrap();
    let eval = ["eval", "--dataset", "folder:pairs", "--iters", "2", "--method"];
    let text =
        succeeds(&srflow(&[&eval[..], &["raft-small=one.safetensors,raft-small=two.safetensors"]].concat()));
    assert!(text.contains("raft-small (one)") && text.contains("raft-small (two)"), "{text}");
    let text = succeeds(&srflow(
        &[&eval[..], &["farneback", "raft-small", "--weights", "one.safetensors", "--tile", "128x128"]]
            .concat(),
    ));
    assert!(text.contains("raft-small ") && text.contains("farneback"), "{text}");
    let error = fails(&srflow(&[&eval[..], &["raft", "gma", "--weights", "one.safetensors"]].concat()), 2);
    assert!(error.contains("--method NETWORK=WEIGHTS"), "{error}");
}

#[test]
fn scores_are_the_same_however_many_pairs_at_once() {
    let dir = data().join("three-pairs");
    fs::create_dir(&dir).unwrap();
    for pair in 0..3 {
        for (name, number) in [("img1", pair), ("img2", pair + 1)] {
            write_image_png(&dir.join(format!("{pair}_{name}.png")), &frame(number)).unwrap();
        }
        let truth = FlowField::filled(SIZE.0, SIZE.1, [2.0, 0.0]);
        write_flow(&dir.join(format!("{pair}_flow.flo")), &truth).unwrap();
    }
    let epes = |batch: &str| -> Vec<f64> {
        let eval = ["eval", "--dataset", "folder:three-pairs", "--method", "raft-small=one.safetensors"];
        let text = succeeds(&srflow(&[&eval[..], &["--iters", "2", "--json", "--batch", batch]].concat()));
        let evaluation: Value = serde_json::from_str(&text).unwrap();
        let pairs = evaluation["methods"][1]["pairs"].as_array().unwrap();
        pairs.iter().map(|pair| pair["whole"]["epe"].as_f64().unwrap()).collect()
    };
    let alone = epes("1");
    assert_eq!(alone.len(), 3);
    for batch in ["2", "3", "8"] {
        for (together, alone) in epes(batch).iter().zip(&alone) {
            assert!((together - alone).abs() < 1e-4, "batch {batch}: {together} for {alone}");
        }
    }
    let error =
        fails(&srflow(&["eval", "--dataset", "folder:three-pairs", "--method", "tvl1", "--batch", "2"]), 2);
    assert!(error.contains("--batch is for networks"), "{error}");
}

/// `ffmpeg` and `ffprobe` that give three frames, whatever they are asked for, and keep what they are given.
#[cfg(unix)]
#[test]
fn videos_go_through_ffmpeg() {
    use std::os::unix::fs::PermissionsExt as _;
    let dir = data().join("programs");
    fs::create_dir(&dir).unwrap();
    let mut stream = Vec::new();
    for number in 0..3 {
        stream.extend_from_slice(format!("P6\n{} {}\n255\n", SIZE.0, SIZE.1).as_bytes());
        stream.extend_from_slice(frame(number).pixels().as_flattened());
    }
    fs::write(data().join("clip.mp4"), &stream).unwrap();
    let program = |name: &str, text: &str| {
        fs::write(dir.join(name), format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(dir.join(name), fs::Permissions::from_mode(0o755)).unwrap();
    };
    // Its last argument is `-` when it reads a video, else the video to write.
    program(
        "ffmpeg",
        "for last; do :; done\nif [ \"$last\" = - ]; then cat clip.mp4; else cat > \"$last\"; fi",
    );
    program("ffprobe", "echo r_frame_rate=30/1; echo nb_read_packets=3");
    let run = |path: &str, more: &[&str]| {
        let raft = ["flow", "--method", "raft-small=one.safetensors", "--iters", "2", "clip.mp4"];
        let mut command = crate::srflow();
        command.current_dir(data()).env("PATH", path).args(raft).args(more).output().unwrap()
    };
    let path = format!("{}:/usr/bin:/bin", dir.display());
    let viz = ["-o", "clip", "--viz", "colours.mp4", "--viz-max", "9", "--json"];
    let report: Value = serde_json::from_str(&succeeds(&run(&path, &viz))).unwrap();
    assert_eq!(report["pairs"][1]["flow"], "clip/000002.flo");
    assert_eq!(report["pairs"][1]["frame2"], "clip.mp4 frame 3");
    succeeds(&flow(&["video/0.png", "video/1.png", "-o", "clip-pair.flo"]));
    assert_eq!(compare(&read("clip/000001.flo"), &read("clip-pair.flo")).0, 0.0);
    assert_eq!(fs::metadata(data().join("colours.mp4")).unwrap().len(), 2 * 3 * (SIZE.0 * SIZE.1) as u64);

    let error = fails(&run(&path, &["-o", "clip"]), 1);
    assert!(error.contains("clip/000001.flo exists"), "{error}");
    let error = fails(&run("/nowhere", &["-o", "no-program"]), 1);
    assert!(error.contains("clip.mp4") && error.contains("ffmpeg, which is not on the PATH"), "{error}");
    program("ffmpeg", "echo moov atom not found >&2; exit 1");
    let error = fails(&run(&path, &["-o", "broken-video"]), 1);
    assert!(error.contains("moov atom not found"), "{error}");
    program("ffmpeg", "head -c 70000 clip.mp4");
    let error = fails(&run(&path, &["-o", "short-video"]), 1);
    assert!(error.contains("ended within a frame"), "{error}");
}
