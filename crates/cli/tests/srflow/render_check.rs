//! `srflow render` and `srflow check` at a tiny size: killed, in parts, on broken data.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use serde_json::Value;

use crate::tree::tree;
use crate::{json, refuses, succeeds};

/// The dataset of most tests: one scene of 7 pairs, since a head takes most of the time.
/// The first look, which is made in half the time.
#[rustfmt::skip]
const TINY: [&str; 12] =
    ["--scenes", "1", "--frames", "7", "--size", "110x160", "--seed", "4", "--splits", "1,0,0", "--look", "1"];

/// The dataset of [`TINY`], which several tests compare with or copy. It is rendered once.
fn whole() -> &'static Path {
    static WHOLE: OnceLock<PathBuf> = OnceLock::new();
    WHOLE.get_or_init(|| {
        let out = crate::binary().with_file_name("dataset-of-tests");
        let _ = fs::remove_dir_all(&out); // of an earlier test run
        let summary = json(&render(&out, &["--json"]));
        assert_eq!((&summary["pairs"], &summary["made"]), (&Value::from(7), &Value::from(7)));
        out
    })
}

fn render(out: &Path, more: &[&str]) -> Output {
    let out = out.to_str().unwrap();
    crate::srflow().args(["render", "--out", out]).args(TINY).args(more).output().unwrap()
}

/// What a run says that stops on request.
fn stops(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(75), "{output:?}");
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn assert_same_tree(a: &Path, b: &Path) {
    let (a, b) = (tree(a), tree(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (path, bytes) in &a {
        assert!(*bytes == b[path], "{} differs", path.display());
    }
}

fn copy_into(from: &Path, to: &Path) {
    for (path, bytes) in tree(from) {
        let target = to.join(path);
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::write(target, bytes).unwrap();
    }
}

fn check(dir: &Path) -> (Output, Value) {
    let output = crate::srflow().args(["check", "--json"]).arg(dir).output().unwrap();
    let report = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output, report)
}

#[test]
fn a_dataset_is_sound_and_explained_by_its_flow() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    let arguments = [
        "--frames",
        "5",
        "--size",
        "220x320",
        "--backward",
        "--depth",
        "--regions",
        "--splits",
        "0,0,1",
        "--json",
    ];
    let mut command = crate::srflow();
    command.args(["render", "--scenes", "1", "--out", out.to_str().unwrap()]).args(arguments);
    let summary = json(&command.output().unwrap());
    assert_eq!(summary["statistics"]["average_frames"], 5.0);
    assert_eq!(summary["statistics"]["scenes"], 1);
    // 6 frames, alphas, masks, depths and region maps; 5 flows, backward flows, occlusions and records; three files for the dataset.
    assert_eq!(tree(&out).len(), 5 * 6 + 4 * 5 + 3);

    let (output, report) = check(&out);
    succeeds(&output);
    assert_eq!((&report["sound"], &report["problems"]), (&Value::from(5), &Value::Array(vec![])));
    let residual = |name: &str| report["residual"][name].as_f64().unwrap();
    assert!(residual("warped") * 2.0 < residual("unwarped"), "{}", report["residual"]);
    assert_eq!(report["statistics"]["flow"]["pixels"], summary["statistics"]["flow"]["pixels"]);

    // Backward flow returns to where forward flow started.
    let file = |kind: &str, ending: &str| out.join(format!("test/{kind}/scene-0000/00002.{ending}"));
    let forward = srflow_files::read_flow(&file("flow", "npz16")).unwrap();
    let backward = srflow_files::read_flow(&file("flow_backward", "npz16")).unwrap();
    let tolerance = srflow_core::Tolerance::Absolute { pixels: 0.3 };
    let consistent = srflow_core::forward_backward_check(&forward, &backward, tolerance).unwrap();
    let mask = srflow_files::read_mask(&file("mask", "png")).unwrap();
    let inside = mask.pixels().iter().filter(|inside| **inside).count();
    let kept =
        mask.pixels().iter().zip(consistent.pixels()).filter(|(inside, kept)| **inside && **kept).count();
    assert!(kept as f64 > 0.9 * inside as f64, "{kept} of {inside}");
}

#[test]
fn sequences_start_and_end_before_camera_nine() {
    let out = whole();
    let manifest: Value = serde_json::from_slice(&fs::read(out.join("dataset.json")).unwrap()).unwrap();
    let canonical = &manifest["rig"][8];
    assert_eq!(canonical["number"], 9);
    let record = |pair: u32| -> Value {
        let path = out.join(format!("train/pairs/scene-0000/{pair:05}.json"));
        serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
    };
    assert_eq!(record(0)["frame1"]["camera"]["w2c"], canonical["w2c"]);
    assert_eq!(record(6)["frame2"]["camera"]["w2c"], canonical["w2c"]);
    assert_ne!(record(3)["frame1"]["camera"]["w2c"], canonical["w2c"]);
    assert_eq!(record(1)["frame1"], record(0)["frame2"]);
    assert_eq!(record(0)["frame1"]["camera"]["width"], 110);
}

#[test]
fn a_stopped_run_continues_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let stopped = dir.path().join("stopped");
    let said = stops(&render(&stopped, &["--stop-after", "2"]));
    assert!(said.contains("stopped on request"), "{said}");
    assert_eq!(whole_pairs(&stopped).len(), 2);
    // Leftovers of a kill during writing: a partial file, and a pair without its last file.
    fs::write(stopped.join("train/frames/scene-0000/.00005.png.1-0.partial"), "half").unwrap();
    fs::remove_file(&whole_pairs(&stopped)[0]).unwrap();

    let rerun = || json(&render(&stopped, &["--json"]))["made"].as_u64().unwrap();
    assert_eq!(rerun(), 6);
    assert_same_tree(whole(), &stopped);
    assert_eq!(rerun(), 0);
}

/// The records of complete pairs.
fn whole_pairs(dir: &Path) -> Vec<PathBuf> {
    let records =
        fs::read_dir(dir.join("train/pairs/scene-0000")).unwrap().map(|entry| entry.unwrap().path());
    records.filter(|path| path.extension().is_some_and(|ending| ending == "json")).collect()
}

#[test]
fn a_split_that_gets_no_scene_is_named_before_any_work() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    let arguments = ["render", "--out", out.to_str().unwrap(), "--scenes", "3", "--stop-after", "0"];
    let said = stops(&crate::srflow().args(arguments).output().unwrap());
    assert!(said.contains("note: the val split is empty: a share of 0.11 of 3 scenes"), "{said}");
}

#[test]
fn parts_merge_by_copying() {
    let dir = tempfile::tempdir().unwrap();
    let merged = dir.path().join("merged");
    for part in ["1/2", "2/2"] {
        let out = dir.path().join(part.replace('/', "-"));
        let stdout = succeeds(&render(&out, &["--shard", part]));
        assert!(stdout.contains(&format!("Part {part} is complete")), "{stdout}");
        copy_into(&out, &merged);
    }
    let mut without_statistics = tree(whole());
    for name in ["statistics.json", "SHA256SUMS"] {
        without_statistics.remove(Path::new(name)).unwrap();
    }
    assert_eq!(tree(&merged).keys().collect::<Vec<_>>(), without_statistics.keys().collect::<Vec<_>>());
    succeeds(&render(&merged, &[]));
    assert_same_tree(whole(), &merged);
}

#[test]
fn another_dataset_is_not_mixed_in() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    copy_into(whole(), &out);
    let before = tree(&out);
    let expected = "a dataset with background \"#ffffff\", requested is \"#000000\"";
    refuses(&render(&out, &["--background", "black"]), 1, &[expected]);
    refuses(&render(&out, &["--depth"]), 1, &["depth false", "--force"]);
    assert!(tree(&out) == before);

    fs::write(out.join("notes.txt"), "mine").unwrap();
    succeeds(&render(&out, &["--background", "black", "--shard", "1/7", "--force"]));
    let after = tree(&out);
    assert_eq!(after[Path::new("notes.txt")], b"mine");
    // dataset.json, notes.txt and the first pair's seven files: nothing is left of the other dataset.
    assert_eq!(after.len(), 2 + 6);
    let frame = Path::new("train/frames/scene-0000/00000.png");
    assert!(before[frame] != after[frame]);

    let other = dir.path().join("other");
    fs::create_dir(&other).unwrap();
    fs::write(other.join("thesis.tex"), "x").unwrap();
    for force in [&[][..], &["--force"]] {
        refuses(&render(&other, force), 1, &["not empty and has no dataset.json"]);
    }
}

#[test]
fn wrong_arguments_are_reported_before_any_work() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    let cases: [(&[&str], i32, &str); 16] = [
        (
            &["--splits", "0.5,0.1,0.1"],
            2,
            "--splits 0.5,0.1,0.1: expected three shares from 0 to 1 that sum to 1",
        ),
        (&["--splits", "0.5,0.5"], 2, "expected 3 numbers between commas"),
        (&["--size", "0x10"], 2, "expected WIDTHxHEIGHT"),
        (&["--size", "99999999x99999999"], 2, "--size 99999999x99999999"),
        (&["--size", "big"], 2, "expected WIDTHxHEIGHT"),
        (&["--frames", "0"], 2, "--frames 0"),
        (&["--frames", "nan"], 2, "--frames NaN"),
        (&["--scenes", "0"], 2, "--scenes 0"),
        (&["--shard", "3/2"], 2, "expected I/N"),
        (&["--background", "/no/such/folder"], 1, "--background /no/such/folder"),
        (&["--background", "#12"], 2, "expected white, black, #rrggbb"),
        (&["--head", "ict:/no/such/folder"], 1, "--head /no/such/folder"),
        (&["--flow-format", "jpeg"], 2, "jpeg"),
        (&["--noise", "nan"], 2, "--noise NaN: expected 0 to 50"),
        (&["--jpeg", "0"], 2, "--jpeg 0: expected 1 to 100"),
        (&["--preset", "tame"], 2, "wild"),
    ];
    for (arguments, code, expected) in cases {
        let mut command = crate::srflow();
        let output =
            command.args(["render", "--out", out.to_str().unwrap()]).args(arguments).output().unwrap();
        refuses(&output, code, &[expected]);
        assert!(!out.exists(), "{arguments:?} made the folder");
    }
    let head = dir.path().join("head");
    fs::create_dir(&head).unwrap();
    fs::write(head.join("generic_neutral_mesh.obj"), "no mesh").unwrap();
    let broken = ["--head", &format!("ict:{}", head.display())];
    refuses(&render(&out, &broken), 1, &["generic_neutral_mesh.obj"]);
    assert!(!out.exists());
    let file = dir.path().join("file");
    fs::write(&file, "x").unwrap();
    refuses(&render(&file.join("data"), &[]), 1, &["file/data"]);
}

/// A limit on file size simulates a full disk: both are write errors.
#[cfg(unix)]
#[test]
fn a_full_disk_is_said_and_the_dataset_resumes() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    let arguments =
        format!("{} render --out {} {}", crate::binary().display(), out.display(), TINY.join(" "));
    // Without the signal for an exceeded limit; 12 blocks of 1024 bytes.
    let script = format!("trap '' XFSZ; ulimit -f 12; exec {arguments}");
    let output = Command::new("bash").args(["-c", &script]).output().unwrap();
    refuses(&output, 1, &[".png: writing:", "run the same command again"]);
    assert!(tree(&out).keys().all(|path| path.extension().is_some_and(|e| e != "partial")));
    succeeds(&render(&out, &[]));
    assert_same_tree(whole(), &out);
}

#[test]
fn backgrounds_stand_still_behind_the_head() {
    let dir = tempfile::tempdir().unwrap();
    let images = dir.path().join("images");
    fs::create_dir(&images).unwrap();
    let picture = srflow_core::Image::from_fn(300, 200, |x, y| [x as u8, y as u8, 200]);
    srflow_files::write_image_png(&images.join("gradient.png"), &picture).unwrap();
    let out = dir.path().join("data");
    succeeds(&render(&out, &["--background", images.to_str().unwrap()]));
    let at = |kind: &str, frame: u32| out.join(format!("train/{kind}/scene-0000/{frame:05}.png"));
    let frames: Vec<_> =
        (0..8).map(|frame| srflow_files::read_image(&at("frames", frame)).unwrap()).collect();
    let (left, right) = (frames[0].get(1, 3), frames[0].get(108, 3));
    assert!(right[0] > left[0] + 40 && left[2].abs_diff(200) < 3, "{left:?} {right:?}");
    assert!(frames.iter().all(|frame| frame.get(1, 3) == left));
    let flow = srflow_files::read_flow(&out.join("train/flow/scene-0000/00001.npz16")).unwrap();
    assert_eq!(flow.get(1, 3), [0.0, 0.0]);
    succeeds(&check(&out).0);
}

#[test]
fn the_preset_wild_gives_what_is_not_given() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    let some = ["--preset", "wild", "--frames", "2", "--motion", "curves", "--noise", "0.5", "--jpeg", "60"];
    succeeds(
        &crate::srflow()
            .args(["render", "--out", out.to_str().unwrap()])
            .args(["--scenes", "1", "--size", "110x160", "--seed", "4", "--splits", "1,0,0"])
            .args(some)
            .output()
            .unwrap(),
    );
    let manifest: Value = serde_json::from_slice(&fs::read(out.join("dataset.json")).unwrap()).unwrap();
    let arguments = &manifest["arguments"];
    assert_eq!(arguments["background"], "procedural");
    assert_eq!(arguments["motion"], Value::Null); // the default
    let recording = &arguments["recording"];
    assert_eq!([&recording["noise"], &recording["jpeg"]], [&Value::from(0.5), &Value::from(60)]);
    assert_eq!(recording["lighting"], 1.0);
    succeeds(&check(&out).0);
}

#[test]
fn broken_files_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("data");
    copy_into(whole(), &out);
    let file = |path: &str| out.join("train").join(path);
    let sound = tree(&out);
    let expect = |path: &str, what: &str| {
        let (output, report) = check(&out);
        assert_eq!(output.status.code(), Some(1));
        let problems = report["problems"].as_array().unwrap();
        let named = problems.iter().any(|problem| {
            problem["file"] == *file(path).to_str().unwrap()
                && problem["what"].as_str().unwrap().contains(what)
        });
        assert!(named, "{path}: {what}: {problems:?}");
        for (path, bytes) in &sound {
            fs::write(out.join(path), bytes).unwrap();
        }
    };
    fs::remove_file(file("flow/scene-0000/00002.npz16")).unwrap();
    expect("flow/scene-0000/00002.npz16", "missing");
    let frame = fs::read(file("frames/scene-0000/00007.png")).unwrap();
    fs::write(file("frames/scene-0000/00007.png"), &frame[..frame.len() / 2]).unwrap();
    expect("frames/scene-0000/00007.png", "");
    let small = srflow_core::Mask::new(11, 16);
    srflow_files::write_mask_png(&file("occlusion/scene-0000/00000.png"), &small).unwrap();
    expect("occlusion/scene-0000/00000.png", "expected 110x160 as in dataset.json, found 11x16");
    srflow_files::write_mask_png(&file("mask/scene-0000/00001.png"), &srflow_core::Mask::new(110, 160))
        .unwrap();
    expect("mask/scene-0000/00001.png", "differs from alpha");
    fs::write(file("pairs/scene-0000/00000.json"), "{").unwrap();
    expect("pairs/scene-0000/00000.json", "");
    // A valid file with the wrong content.
    let flow = srflow_files::read_flow(&file("flow/scene-0000/00003.npz16")).unwrap();
    let wrong = flow.pixels().iter().map(|[u, v]| [u + 7.0, v - 5.0]).collect();
    let wrong = srflow_core::FlowField::from_pixels(110, 160, wrong).unwrap();
    srflow_files::write_flow(&file("flow/scene-0000/00003.npz16"), &wrong).unwrap();
    expect("flow/scene-0000/00003.npz16", "does not explain the frames");
    fs::write(file("mask/scene-0000/.00001.png.77-3.partial"), "half").unwrap();
    let (output, report) = check(&out);
    assert_eq!(output.status.code(), Some(1));
    assert!(report["problems"][0]["file"].as_str().unwrap().ends_with(".00001.png.77-3.partial"));
    fs::remove_file(out.join("dataset.json")).unwrap();
    refuses(&check(&out).0, 1, &["dataset.json"]);
}
