//! `srflow flow` and `srflow eval` with networks. The weights are random: the flow is meaningless, but reproducible.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use burn::tensor::Device;
use safetensors::tensor::{Dtype, TensorView};
use srflow_core::{FlowField, Image, Size};
use srflow_files::{read_flow, read_image, read_npy_plane, write_flow, write_image_png};
use srflow_nets::Architecture;
use srflow_nn::parameter_infos;

use crate::frames::{waves, write_frames, write_pairs};
use crate::{json, notes, refuses, succeeds};

const SIZE: Size = Size::new(150, 133);

/// Random weights with a variance that preserves the magnitude of activations.
fn write_weights(path: &Path, architecture: Architecture, seed: u32) {
    let mut state = seed;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    };
    let infos = parameter_infos(&architecture.init(&Device::flex()));
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = infos
        .into_iter()
        .map(|info| {
            let fan_in: usize = info.shape[1..].iter().product();
            let named = |parts: &[&str]| parts.iter().any(|part| info.name.contains(part));
            // Blocks that add to their input would let it grow; attention is to differ between pixels.
            let gain = if named(&["ffn1.2.", "conv_list.", "pw."]) { 0.5 } else { 1.0 };
            let gain = if named(&["to_qk."]) { 4.0 } else { gain };
            let scale = if info.shape.len() > 1 { gain * (3.0 / fan_in as f32).sqrt() } else { 0.1 };
            let mean = if named(&["running_var", "gamma"]) { 1.0 } else { 0.0 };
            let count: usize = info.shape.iter().product();
            let bytes = (0..count).flat_map(|_| (mean + scale * noise()).to_le_bytes()).collect();
            (info.name, info.shape, bytes)
        })
        .collect();
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    fs::write(path, safetensors::serialize(views, None).unwrap()).unwrap();
}

/// A folder with six frames and files of weights.
fn data() -> &'static Path {
    static DATA: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = DATA.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().to_owned();
        write_frames(&path.join("video"), 0..6, SIZE);
        write_weights(&path.join("one.safetensors"), Architecture::RaftSmall, 1);
        write_weights(&path.join("two.safetensors"), Architecture::RaftSmall, 2);
        write_weights(&path.join("rpknet.safetensors"), Architecture::RpkNet, 3);
        write_weights(&path.join("unimatch-sc2.safetensors"), Architecture::UniMatchSc2, 3);
        write_weights(&path.join("memflow.safetensors"), Architecture::MemFlow, 4);
        write_weights(&path.join("sea-raft-s.safetensors"), Architecture::SeaRaftS, 5);
        write_weights(&path.join("dpflow.safetensors"), Architecture::DpFlow, 6);
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
    let report = json(&flow(&arguments));
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

/// Also where the processor has no instructions for bfloat16.
#[test]
fn products_of_bfloat16_change_the_flow_a_little() {
    let of = |precision: &str, out: &str| {
        let pair = ["video/0.png", "video/1.png", "-o", out, "--json"];
        let more = if precision.is_empty() { vec![] } else { vec!["--precision", precision] };
        json(&flow(&[&pair[..], &more].concat()))["network"]["precision"].as_str().unwrap().to_owned()
    };
    assert_eq!(of("", "pair/f32.flo"), "f32");
    assert_eq!(of("bf16", "pair/bf16.flo"), "bf16");
    let chosen = of("auto", "pair/auto.flo");
    assert_eq!(read("pair/auto.flo"), read(&format!("pair/{chosen}.flo")));
    let (far, long) = compare(&read("pair/f32.flo"), &read("pair/bf16.flo"));
    assert!(far > 0.0 && far < 0.1 * long, "{far} px apart of {long}");
}

/// In a file beside the flow of a pair, and in a folder along a sequence, with pictures if the flow has them.
#[test]
fn uncertainty_is_written_beside_the_flow() {
    let sea_raft = |more: &[&str]| {
        let method = ["flow", "--method", "sea-raft-s=sea-raft-s.safetensors", "--iters", "2", "--json"];
        srflow(&[&method, more].concat())
    };
    let pair = ["video/0.png", "video/1.png"];
    let plane = |file: &str| read_npy_plane(&data().join(file)).unwrap();
    let files = ["-o", "sure/a.flo", "--uncertainty", "sure/a.npy", "--viz", "sure/flow.png"];
    let report = json(&sea_raft(&[&pair[..], &files].concat()));
    assert_eq!(report["pairs"][0]["uncertainty"], "sure/a.npy");
    let alone = plane("sure/a.npy");
    assert_eq!(alone.size(), SIZE);
    assert!(alone.pixels().iter().all(|pixels| *pixels >= 1.0), "the smallest scale is that of 1 pixel");
    assert_eq!(read_image(&data().join("sure/a.png")).unwrap().size(), SIZE);

    let folders = ["-o", "sure/flows", "--uncertainty", "sure/planes", "--tile", "160x160", "--scale", "0.9"];
    succeeds(&sea_raft(&[&["video"][..], &folders].concat()));
    let scaled: Vec<f32> = (0..5).map(|n| plane(&format!("sure/planes/{n}.npy")).get(70, 60)).collect();
    assert!(scaled.iter().all(|pixels| *pixels > 1.05), "of smaller frames: {scaled:?}");
    assert!(!data().join("sure/planes/0.png").exists() && !data().join("sure/planes/5.npy").exists());

    let refused = |more: &[&str], words: &[&str]| refuses(&sea_raft(&[&pair[..], more].concat()), 2, words);
    refused(&["-o", "sure/b.flo", "--uncertainty", "sure/b.png"], &["sure/b.png", ".npy"]);
    refused(&["-o", "sure/b.npy", "--uncertainty", "sure/b.npy"], &["sure/b.npy", "overwrite each other"]);
    refused(
        &["-o", "sure/b.flo", "--occlusion", "sure/b.npy"],
        &["--occlusion", "sea-raft-s does not predict"],
    );
    refused(
        &["-o", "sure/b.flo", "--uncertainty", "sure/b.npy", "--initial-flow", "sure/a.flo"],
        &["--initial-flow"],
    );
    let video = ["video", "-o", "sure/x", "--viz", "sure/y", "--uncertainty", "sure/y/"];
    refuses(&sea_raft(&video), 2, &["sure/y", "overwrite each other"]);
    let classical = ["flow", "--method", "tvl1", "video", "-o", "sure/z", "--uncertainty", "sure/u"];
    refuses(&srflow(&classical), 2, &["tvl1 does not predict", "sea-raft-m"]);
    // Existing files are not overwritten.
    let again = sea_raft(&[&pair[..], &["-o", "sure/c.flo", "--uncertainty", "sure/a.npy"]].concat());
    refuses(&again, 1, &["sure/a.npy", "--force"]);
}

/// The groups of RPKNet's norms, of which its weights say nothing.
#[test]
fn a_setting_changes_what_a_network_computes() {
    let rpknet = |more: &[&str]| {
        let method = ["flow", "--method", "rpknet=rpknet.safetensors", "--iters", "3", "--json"];
        srflow(&[&method, more, &["video/0.png", "video/1.png"]].concat())
    };
    let groups = |out: &str, more: &[&str]| {
        let report = json(&rpknet(&[&["-o", out], more].concat()));
        (report["network"]["settings"]["groups"].as_u64().unwrap(), read(out))
    };
    let (of_itself, flow) = groups("groups/default.flo", &[]);
    let (same, as_given) = groups("groups/8.flo", &["--set", "groups=8"]);
    let (other, fewer) = groups("groups/4.flo", &["--set", "groups=4"]);
    assert_eq!([of_itself, same, other], [8, 8, 4]);
    assert_eq!(flow, as_given);
    assert!(compare(&flow, &fewer).0 > 0.01);

    refuses(
        &rpknet(&["--set", "groups=3", "-o", "3.flo"]),
        2,
        &["groups to be 1, 2, 4, 8, 16 or 32, found 3"],
    );
    refuses(&rpknet(&["--set", "depth=2", "-o", "2.flo"]), 2, &["--set depth: no network has this setting"]);
    let pair = ["video/0.png", "video/1.png", "-o", "no.flo"];
    refuses(&self::flow(&[&["--set", "groups=4"], &pair[..]].concat()), 2, &["a setting of rpknet"]);
}

/// Of DPFlow's pyramid: 3 for small frames.
#[test]
fn the_report_names_the_levels_in_which_flow_is_refined() {
    let dpflow = |more: &[&str]| {
        let method = ["flow", "--method", "dpflow=dpflow.safetensors", "--iters", "1", "--json"];
        srflow(&[&method, more, &["video/0.png", "video/1.png"]].concat())
    };
    let levels = |out: &str, more: &[&str]| {
        let report = json(&dpflow(&[&["-o", out], more].concat()));
        (report["network"]["levels"].as_u64().unwrap(), read(out))
    };
    let (of_size, flow) = levels("levels/size.flo", &[]);
    let (three, same) = levels("levels/3.flo", &["--set", "levels=3"]);
    let (four, other) = levels("levels/4.flo", &["--set", "levels=4"]);
    assert_eq!([of_size, three, four], [3, 3, 4]);
    assert_eq!(flow, same);
    assert!(compare(&flow, &other).0 > 0.01);
    refuses(
        &dpflow(&["--set", "levels=2", "-o", "2.flo"]),
        2,
        &["levels to be 0, 3, 4, 5, 6, 7 or 8, found 2"],
    );
}

#[test]
fn unimatch_has_settings_for_each_scale() {
    let run = |out: &str, more: &[&str]| {
        let method = ["flow", "--method", "unimatch-sc2=unimatch-sc2.safetensors", "--json", "-o", out];
        let report = json(&srflow(&[&method, more, &["video/0.png", "video/1.png"]].concat()));
        let names = [
            "attn_splits_1",
            "corr_radius_1",
            "prop_radius_1",
            "attn_splits_2",
            "corr_radius_2",
            "prop_radius_2",
        ];
        (names.map(|name| report["network"]["settings"][name].as_u64().unwrap()), read(out))
    };
    let (settings, flow) = run("unimatch/default.flo", &[]);
    assert_eq!(settings, [2, 0, 0, 8, 4, 1], "those of the published networks");
    for change in
        ["attn_splits_1=1", "corr_radius_1=8", "prop_radius_1=2", "attn_splits_2=4", "corr_radius_2=2"]
    {
        let (_, other) = run("unimatch/other.flo", &["--force", "--set", change]);
        assert!(compare(&flow, &other).0 > 1e-3, "{change}");
    }
}

/// With any batch size.
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

/// MemFlow along three frames of one shot and two of another: it remembers the first pair in the second, and starts anew after
/// the cut. `srflow eval` on the same frames gives the same flows.
#[test]
fn a_network_that_remembers_starts_anew_at_a_cut() {
    let dark = |mut image: Image| {
        image.pixels_mut().as_flattened_mut().iter_mut().for_each(|level| *level /= 8);
        image
    };
    let waves = |number: usize| waves(SIZE, 2.0 * number as f32);
    let shots = (0..5).map(|number| if number < 3 { waves(number) } else { dark(waves(number)) });
    for folder in ["shots/frames", "shots/flow"] {
        fs::create_dir_all(data().join(folder)).unwrap();
    }
    for (number, image) in shots.enumerate() {
        write_image_png(&data().join(format!("shots/frames/{number}.png")), &image).unwrap();
        if number < 4 {
            let truth = FlowField::filled(SIZE.width, SIZE.height, [2.0, 0.0]);
            write_flow(&data().join(format!("shots/flow/{number}.flo")), &truth).unwrap();
        }
    }
    let memflow = ["--method", "memflow=memflow.safetensors", "--iters", "2"];
    let flow = |more: &[&str]| srflow(&[&["flow"], &memflow[..], more].concat());
    for number in 0..4 {
        let pair = [number, number + 1].map(|number| format!("shots/frames/{number}.png"));
        succeeds(&flow(&["-o", &format!("shots-alone/{number}.flo"), &pair[0], &pair[1]]));
    }
    succeeds(&flow(&["-o", "shots-video", "shots/frames"]));
    succeeds(&flow(&["-o", "shots-without", "shots/frames", "--set", "remembered_pairs=0"]));
    let eval = ["eval", "--dataset", "folder:shots", "--save-flow", "shots-scored"];
    succeeds(&srflow(&[&eval[..], &memflow].concat()));
    for (number, same) in [true, false, true, true].into_iter().enumerate() {
        let file = |folder: &str| read(&format!("{folder}/{number}.flo"));
        let (far, long) = compare(&file("shots-video"), &file("shots-alone"));
        assert!(if same { far == 0.0 } else { far > 1e-3 }, "pair {number}: {far} px of {long}");
        assert_eq!(compare(&file("shots-without"), &file("shots-alone")).0, 0.0, "pair {number}");
        assert_eq!(compare(&file("shots-scored/memflow"), &file("shots-video")).0, 0.0, "pair {number}");
    }
    let batch = ["-o", "shots-batch", "shots/frames", "--batch", "2"];
    refuses(&flow(&batch), 2, &["memflow waits for the pair before"]);

    // A run that ends before its second flow and is given again: what comes later depends on what came before.
    fs::create_dir_all(data().join("shots-again/1.flo")).unwrap();
    refuses(&flow(&["-o", "shots-again", "shots/frames", "--force"]), 1, &["1.flo"]);
    fs::remove_dir(data().join("shots-again/1.flo")).unwrap();
    succeeds(&flow(&["-o", "shots-again", "shots/frames"]));
    assert_eq!(compare(&read("shots-again/1.flo"), &read("shots-video/1.flo")).0, 0.0);
}

#[test]
fn large_frames_are_cut_or_scaled_and_the_report_says_how() {
    let resolution = |name: &str, more: &[&str]| {
        let out = format!("large/{name}.flo");
        let pair = ["video/0.png", "video/1.png", "-o", &out, "--json"];
        let report = json(&flow(&[&pair, more].concat()));
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
fn errors_name_the_problem() {
    fs::write(data().join("broken.ckpt"), b"not a checkpoint at all").unwrap();
    let pair = ["video/0.png", "video/1.png", "-o", "never.flo"];
    let refused = |arguments: &[&str], code: i32, expected: &[&str]| {
        refuses(&srflow(&[&["flow"], arguments, &pair].concat()), code, expected);
        assert!(!data().join("never.flo").exists(), "{arguments:?}");
    };
    refused(&["--method", "raft"], 2, &["raft needs weights", "--weights FILE", "srflow models"]);
    refused(&["--method", "pwc"], 2, &["unknown method `pwc`", "farneback, tvl1, srflow, raft"]);
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
    for wrong in
        ["--iters=0", "--iters=-1", "--iters=x", "--iters=auto:", "--iters=auto:0", "--iters=auto:nan"]
    {
        let found = wrong.replace("--iters=", "found `") + "`";
        refused(&with(one, &[wrong]), 2, &["--iters", "auto:0.07", &found]);
    }
    let one_pass = ["--method", "unimatch-sc2=unimatch-sc2.safetensors", "--iters", "auto"];
    refused(&one_pass, 2, &["--iters is for networks that refine their flow", "unimatch-sc2"]);
    refused(&with(one, &["--device", "gpu"]), 2, &["--device", "cpu, cuda, vulkan"]);
    refused(&with(one, &["--device", "cpu:7"]), 2, &["--device", "cpu:7"]);
    refused(&with(one, &["--precision", "half"]), 2, &["--precision", "f32, f16, bf16, auto"]);
    refused(&with(one, &["--precision", "f16"]), 2, &["--precision", "--device cpu", "it has f32, bf16"]);
    refused(&["--method", "tvl1", "--precision", "bf16"], 2, &["--precision is for networks"]);
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
    let expected = ["sizes/0.png is 150x133", "sizes/2.png is 140x133"];
    refuses(&flow(&["sizes", "-o", "sized"]), 1, &expected);
    assert!(!data().join("sized").exists());
}

#[test]
fn tables_name_networks_by_their_weights() {
    write_pairs(&data().join("pairs"), 1, SIZE, 2.0);
    let eval = ["eval", "--dataset", "folder:pairs", "--iters", "2", "--method"];
    let eval = |methods: &[&str]| srflow(&[&eval[..], methods].concat());
    let text = succeeds(&eval(&["raft-small=one.safetensors,raft-small=two.safetensors"]));
    assert!(text.contains("raft-small (one)") && text.contains("raft-small (two)"), "{text}");
    let methods = ["farneback", "raft-small", "--weights", "one.safetensors", "--tile", "128x128"];
    let text = succeeds(&eval(&methods));
    assert!(text.contains("raft-small ") && text.contains("farneback"), "{text}");
    refuses(&eval(&["raft", "gma", "--weights", "one.safetensors"]), 2, &["--method NETWORK=WEIGHTS"]);
}

#[test]
fn scores_are_the_same_however_many_pairs_at_once() {
    write_pairs(&data().join("three-pairs"), 3, SIZE, 2.0);
    let epes = |batch: &str| -> Vec<f64> {
        let eval = ["eval", "--dataset", "folder:three-pairs", "--method", "raft-small=one.safetensors"];
        let evaluation = json(&srflow(&[&eval[..], &["--iters", "2", "--json", "--batch", batch]].concat()));
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
    let tvl1 = ["eval", "--dataset", "folder:three-pairs", "--method", "tvl1", "--batch", "2"];
    refuses(&srflow(&tvl1), 2, &["--batch is for networks"]);
}

/// The flow is that of the number of iterations that was done, which reports and tables say.
#[test]
fn auto_stops_once_the_flow_is_still() {
    let arguments = |iters: &'static str, out: &'static str| {
        let method = ["flow", "--method", "raft-small=one.safetensors", "--iters", iters];
        [&method[..], &["video/0.png", "video/1.png", "-o", out]].concat()
    };
    let report = |iters, out| json(&srflow(&[&arguments(iters, out)[..], &["--json"]].concat()));
    let auto = report("auto:1000", "auto/auto.flo");
    assert_eq!(auto["network"]["iterations"], 32, "at most");
    assert_eq!(auto["network"]["still_px"], 1000.0);
    assert_eq!(auto["pairs"][0]["iterations"], 2.0);
    let fixed = report("2", "auto/fixed.flo");
    assert!(fixed["network"].get("still_px").is_none() && fixed["pairs"][0].get("iterations").is_none());
    assert_eq!(read("auto/auto.flo"), read("auto/fixed.flo"));
    let text = succeeds(&srflow(&arguments("auto:1000", "auto/text.flo")));
    assert!(text.contains(" s  2 iterations"), "{text}");

    write_pairs(&data().join("auto-pairs"), 2, SIZE, 2.0);
    let methods = ["raft-small=one.safetensors", "unimatch-sc2=unimatch-sc2.safetensors", "farneback"];
    let eval = ["eval", "--dataset", "folder:auto-pairs", "--batch", "2", "--iters", "auto:1000", "--method"];
    let eval = [&eval[..], &methods].concat();
    let scores = json(&srflow(&[&eval[..], &["--json"]].concat()));
    let iterations: Vec<_> =
        scores["methods"].as_array().unwrap().iter().map(|method| method["iterations"].as_f64()).collect();
    assert_eq!(iterations, [None, Some(2.0), None, None]);
    let made_by = scores["made_by"].as_array().unwrap();
    let still_px: Vec<_> = made_by.iter().map(|method| method["still_px"].as_f64()).collect();
    assert_eq!(still_px, [Some(1000.0), None, None]);
    let text = succeeds(&srflow(&eval));
    assert!(text.contains("iterations") && text.contains(" 2.0"), "{text}");
}

/// Fake `ffmpeg` and `ffprobe` that always return three frames, and save their input.
#[cfg(unix)]
#[test]
fn videos_go_through_ffmpeg() {
    use std::os::unix::fs::PermissionsExt as _;
    let dir = data().join("programs");
    fs::create_dir(&dir).unwrap();
    let mut stream = Vec::new();
    for number in 0..3 {
        stream.extend_from_slice(format!("P6\n{} {}\n255\n", SIZE.width, SIZE.height).as_bytes());
        stream.extend_from_slice(waves(SIZE, 2.0 * number as f32).pixels().as_flattened());
    }
    fs::write(data().join("clip.mp4"), &stream).unwrap();
    let program = |name: &str, text: &str| {
        fs::write(dir.join(name), format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(dir.join(name), fs::Permissions::from_mode(0o755)).unwrap();
    };
    // Its last argument is `-` when it reads a video, otherwise the video to write.
    program(
        "ffmpeg",
        "for last; do :; done\nif [ \"$last\" = - ]; then cat clip.mp4; else cat > \"${last#file:}\"; fi",
    );
    program("ffprobe", "echo r_frame_rate=30/1; echo nb_read_packets=3");
    let run = |path: &str, more: &[&str]| {
        let raft = ["flow", "--method", "raft-small=one.safetensors", "--iters", "2", "clip.mp4"];
        let mut command = crate::srflow();
        command.current_dir(data()).env("PATH", path).args(raft).args(more).output().unwrap()
    };
    let path = format!("{}:/usr/bin:/bin", dir.display());
    let viz = ["-o", "clip", "--viz", "colours.mp4", "--viz-max", "9", "--json"];
    let report = json(&run(&path, &viz));
    assert_eq!(report["pairs"][1]["flow"], "clip/000002.flo");
    assert_eq!(report["pairs"][1]["frame2"], "clip.mp4 frame 3");
    succeeds(&flow(&["video/0.png", "video/1.png", "-o", "clip-pair.flo"]));
    assert_eq!(compare(&read("clip/000001.flo"), &read("clip-pair.flo")).0, 0.0);
    assert_eq!(fs::metadata(data().join("colours.mp4")).unwrap().len(), 2 * 3 * SIZE.pixels() as u64);

    // A stream that begins between two key frames: ffmpeg skips to the first and complains.
    let complains = "for last; do :; done\nif [ \"$last\" = - ]; then cat clip.mp4; echo non-existing PPS 0 referenced >&2; \
                     else cat > \"${last#file:}\"; fi";
    program("ffmpeg", complains);
    let output = run(&path, &["-o", "cut-clip", "--viz", "cut-colours.mp4", "--viz-max", "9"]);
    let said = notes(&output);
    let note =
        "note: clip.mp4: reading a video: ffmpeg found 3 frames and printed: non-existing PPS 0 referenced";
    assert!(said.contains(note), "{said}");
    assert!(data().join("cut-clip/000002.flo").is_file() && data().join("cut-colours.mp4").is_file());
    program("ffmpeg", "echo Invalid data >&2");
    refuses(&run(&path, &["-o", "no-frame"]), 1, &["ffmpeg found no frame and printed: Invalid data"]);

    refuses(&run(&path, &["-o", "clip"]), 1, &["clip/000001.flo exists"]);
    let not_found = ["clip.mp4", "ffmpeg, which is not on the PATH"];
    refuses(&run("/nowhere", &["-o", "no-program"]), 1, &not_found);
    program("ffmpeg", "echo moov atom not found >&2; exit 1");
    refuses(&run(&path, &["-o", "broken-video"]), 1, &["moov atom not found"]);
    program("ffmpeg", "head -c 70000 clip.mp4");
    refuses(&run(&path, &["-o", "short-video"]), 1, &["ended within a frame"]);
}
