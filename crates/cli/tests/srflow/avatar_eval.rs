//! `srflow avatar eval` from a user's view.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use srflow_avatar::Avatar;
use srflow_avatar::capture::{Capture, HeadRecord};
use srflow_core::Size;
use srflow_files::read_image;
use srflow_head::HeadParameters;

use crate::{fails, json, refuses, succeeds};

/// A folder with a capture of the built-in head of seed 6 by two cameras, and this head as an avatar.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let dir = crate::binary().with_file_name("avatar-eval-of-tests");
        let _ = fs::remove_dir_all(&dir); // of an earlier test run
        let made = crate::srflow()
            .args([
                "avatar",
                "capture",
                "--cameras",
                "2",
                "--timesteps",
                "4",
                "--size",
                "110x160",
                "--seed",
                "6",
                "--out",
            ])
            .arg(dir.join("capture"))
            .output();
        succeeds(&made.unwrap());
        let parameters = Capture::read(&dir.join("capture")).unwrap().parameters().unwrap();
        write_avatar(&dir.join("avatar"), 6, &parameters);
        dir
    })
}

fn write_avatar(dir: &Path, seed: u64, parameters: &HeadParameters) {
    let avatar = Avatar::builtin(seed).unwrap();
    let record = HeadRecord::new("builtin".into(), seed, avatar.model());
    avatar.write(dir, parameters, Some(&record)).unwrap();
}

fn eval(arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder()).args(["avatar", "eval"]).args(arguments).output().unwrap()
}

#[test]
fn the_true_head_scores_like_itself() {
    let out = tempfile::tempdir().unwrap();
    let to = out.path().to_str().unwrap();
    let arguments = ["avatar", "capture", "--flow", "--step", "1", "2", "--out", to];
    let report = json(&eval(&[&arguments[..], &["--json"]].concat()));
    let pictures = report["pictures"].as_array().unwrap();
    let counts: Vec<_> =
        pictures.iter().map(|split| (split["split"].as_str(), split["pictures"].as_u64())).collect();
    assert_eq!(counts, [(Some("val"), Some(3)), (Some("test"), Some(2))]);
    for split in pictures {
        let [psnr, of_channels] = ["psnr", "psnr_channels"].map(|key| split[key].as_f64().unwrap());
        assert!(psnr > 40.0 && of_channels >= psnr && split["ssim"].as_f64().unwrap() > 0.99, "{split}");
        assert!(split["worst"]["psnr"].as_f64().unwrap() <= split["best"]["psnr"].as_f64().unwrap());
    }
    assert_eq!(pictures[1]["cameras"].as_array().unwrap().len(), 2);
    let flow = report["flow"]["results"].as_array().unwrap();
    let sets: Vec<_> =
        flow.iter().map(|set| (set["split"].as_str(), set["step"].as_u64(), set["pairs"].as_u64())).collect();
    assert_eq!(sets, [(Some("val"), Some(1), Some(2)), (Some("val"), Some(2), Some(1))]);
    let mesh = report["flow"]["mesh"]["parts"].as_array().unwrap();
    assert!(mesh.iter().all(|part| part["mean_mm"].as_f64().unwrap() < 0.01), "{mesh:?}");
    for set in flow {
        // Opacities and scales go through their logarithms in the files of the avatar.
        assert!(set["head"]["errors"]["mean"].as_f64().unwrap() < 0.01, "{set}");
        assert!(set["head"]["errors"]["true_length"].as_f64().unwrap() > 0.1, "{set}");
        let pixels =
            ["skin", "eyes", "mouth", "hair", "neck"].map(|part| set[part]["pixels"].as_u64().unwrap());
        assert_eq!(pixels.iter().sum::<u64>(), set["head"]["pixels"].as_u64().unwrap());
    }
    let saved: serde_json::Value =
        serde_json::from_slice(&fs::read(out.path().join("eval.json")).unwrap()).unwrap();
    assert_eq!(saved, report);
    for name in ["picture_val_worst", "picture_test_best", "flow_val_step1", "flow_val_step2"] {
        let panels = fs::read_dir(out.path().join("panels")).unwrap().map(|entry| entry.unwrap().path());
        let found: Vec<PathBuf> =
            panels.filter(|path| path.file_name().unwrap().to_string_lossy().starts_with(name)).collect();
        assert!(!found.is_empty(), "{name}");
        assert_eq!(read_image(&found[0]).unwrap().size(), Size::new(330, 160));
    }
    let page = fs::read_to_string(out.path().join("report.html")).unwrap();
    assert!(page.contains("Flow of the avatar") && page.contains("held-out camera"));
    refuses(&eval(&arguments), 1, &["eval.json exists", "--force"]);
    succeeds(&eval(&["avatar", "capture", "--split", "val", "--out", to, "--force"]));
    let panels = fs::read_dir(out.path().join("panels")).unwrap().map(|entry| entry.unwrap().file_name());
    let names: Vec<String> = panels.map(|name| name.to_string_lossy().into_owned()).collect();
    assert!(names.len() == 2 && names.iter().all(|name| name.starts_with("picture_val")), "{names:?}");
}

#[test]
fn the_avatar_of_a_training_is_rendered_as_there() {
    let out = tempfile::tempdir().unwrap();
    let run = out.path().join("run");
    let trained = crate::srflow()
        .current_dir(folder())
        .args(["avatar", "train", "capture", "--iterations", "3", "--set", "background=[0, 0.5, 0]", "--out"])
        .arg(&run)
        .output();
    assert!(trained.unwrap().status.success());
    let at_the_end: serde_json::Value =
        serde_json::from_slice(&fs::read(run.join("scores.json")).unwrap()).unwrap();
    let run = run.to_str().unwrap();
    let psnr = |more: &[&str]| {
        let report = json(&eval(&[&[run, "capture", "--json", "--split", "val"], more].concat()));
        report["pictures"][0]["psnr"].as_f64().unwrap()
    };
    let expected = at_the_end["splits"][0]["psnr"].as_f64().unwrap();
    assert!((psnr(&[]) - expected).abs() < 1e-3, "{at_the_end}");
    assert!((psnr(&["--background", "white"]) - expected).abs() > 1.0);
}

#[test]
fn scores_are_printed_as_tables() {
    let text = succeeds(&eval(&["avatar@builtin", "capture", "--split", "val", "--limit", "1", "--flow"]));
    for part in [
        "PSNR, whole picture",
        "PSNR, mean of channels",
        "val: best timestep",
        "held-out camera (val), pairs: 1",
        "zero flow",
    ] {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
    assert!(!text.contains("held-out timesteps"), "{text}");
}

#[test]
fn avatars_and_captures_that_do_not_belong_together_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    fails(&eval(&[]), 2);
    fails(&eval(&["avatar"]), 2);
    refuses(&eval(&["nowhere", "capture"]), 1, &["nowhere", "point_cloud.ply and flame_param.npz"]);
    refuses(&eval(&["avatar", "nowhere"]), 1, &["nowhere", "transforms.json"]);
    refuses(&eval(&["avatar", "capture", "--split", "all"]), 2, &["train, val, test"]);
    refuses(&eval(&["avatar", "capture", "--step", "2"]), 2, &["--flow"]);
    refuses(&eval(&["avatar", "capture", "--flow", "--step", "9"]), 2, &["--step [9]", "4 timesteps"]);

    let parameters = Capture::read(&folder().join("capture")).unwrap().parameters().unwrap();
    write_avatar(&dir.path().join("other"), 7, &parameters);
    refuses(&eval(&[&path("other"), "capture"]), 1, &["it shows the head builtin of seed 6"]);
    let fewer = HeadParameters { poses: parameters.poses[1..].to_vec(), ..parameters.clone() };
    write_avatar(&dir.path().join("shorter"), 6, &fewer);
    refuses(&eval(&[&path("shorter"), "capture"]), 1, &["4 timesteps", "the motion of the avatar 3"]);

    // The same pictures without their origin.
    let real = dir.path().join("real");
    fs::create_dir(&real).unwrap();
    for name in ["transforms_train.json", "transforms_val.json", "transforms_test.json", "head.json"] {
        fs::copy(folder().join("capture").join(name), real.join(name)).unwrap();
    }
    let of_real = eval(&["avatar", &path("real"), "--flow"]);
    refuses(&of_real, 1, &["the true flow is not known: it has no capture.json"]);
}
