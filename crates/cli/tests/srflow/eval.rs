//! `srflow eval` as a user meets it: on a folder made here, and on what is wrong with folders.

use std::path::Path;
use std::process::Output;

use srflow_field::{FlowField, Image, Mask, write_flow, write_image_png, write_mask_png};

const SIZE: (usize, usize) = (120, 96);
const SHIFT: f32 = 3.0;

/// Smooth waves, so that a shift can be found.
fn frame(shift: f32) -> Image {
    Image::from_fn(SIZE.0, SIZE.1, |x, y| {
        let (x, y) = (x as f32 - shift, y as f32);
        let wave = (x * 0.31).sin() + (y * 0.27).sin() + ((x + y) * 0.13).cos() + (x * 0.11 - y * 0.17).sin();
        [(128.0 + 30.0 * wave) as u8; 3]
    })
}

fn make_pairs(dir: &Path, count: usize) {
    for i in 0..count {
        let file = |ending: &str| dir.join(format!("p{i}_{ending}"));
        write_image_png(&file("img1.png"), &frame(i as f32)).unwrap();
        write_image_png(&file("img2.png"), &frame(i as f32 + SHIFT)).unwrap();
        write_flow(&file("flow.flo"), &FlowField::filled(SIZE.0, SIZE.1, [SHIFT, 0.0])).unwrap();
        let head = Mask::from_fn(SIZE.0, SIZE.1, |x, y| (30..90).contains(&x) && (20..80).contains(&y));
        write_mask_png(&file("mask.png"), &head).unwrap();
    }
}

fn eval(arguments: &[&str]) -> Output {
    crate::srflow().arg("eval").args(arguments).output().expect("srflow runs")
}

fn folder(dir: &Path) -> String {
    format!("folder:{}", dir.display())
}

/// Exit code and standard error of a run that must fail.
fn failure(arguments: &[&str]) -> (i32, String) {
    let output = eval(arguments);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!error.contains("panicked"), "{error}");
    (output.status.code().unwrap(), error)
}

#[test]
fn scores_are_printed_and_written() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 2);
    let dataset = folder(dir.path());
    let out = dir.path().join("scores");
    let out_text = out.display().to_string();
    let arguments = ["--dataset", &dataset, "--method", "farneback", "--crop", "64x48", "--out", &out_text];
    let run = eval(&arguments);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let text = String::from_utf8(run.stdout).unwrap();
    for part in ["EPE ↓", "px1 ↑", "F1-ALL ↓", "WAUC ↑", "zero", "farneback", "64x48", "inside the head mask"]
    {
        assert!(text.contains(part), "{part} in {text}");
    }
    let json = eval(&["--dataset", &dataset, "--method", "farneback", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    let epe = |method: usize, region: &str| json["methods"][method][region]["epe"].as_f64().unwrap();
    assert!((epe(0, "whole") - f64::from(SHIFT)).abs() < 1e-6);
    assert!(epe(1, "head") < 0.5, "{}", epe(1, "head"));

    let csv = std::fs::read_to_string(out.join("scores.csv")).unwrap();
    assert!(csv.starts_with("method,region,epe,px1,px3,px5,f1_all,wauc"), "{csv}");
    assert!(std::fs::read_to_string(out.join("report.html")).unwrap().contains("farneback"));
    assert!(std::fs::read_to_string(out.join("scores.tex")).unwrap().contains("\\toprule"));

    let (code, error) = failure(&arguments);
    assert!(code == 1 && error.contains("scores.txt") && error.contains("--force"), "{error}");
    let forced: Vec<&str> = arguments.iter().copied().chain(["--force"]).collect();
    assert!(eval(&forced).status.success());
}

#[test]
fn wrong_names_list_the_right_ones() {
    let (code, error) = failure(&["--dataset", "folder:.", "--method", "crystal-ball"]);
    assert!(code == 2 && error.contains("crystal-ball") && error.contains("farneback"), "{error}");
    let (code, error) = failure(&["--dataset", "imagenet:.", "--method", "farneback"]);
    assert!(code == 2 && error.contains("imagenet") && error.contains("sintel"), "{error}");
    let (code, error) = failure(&["--dataset", "folder", "--method", "farneback"]);
    assert!(code == 2 && error.contains("KIND:DIR"), "{error}");
    let (code, error) = failure(&["--dataset", "folder:.", "--method", "farneback", "--split", "holdout"]);
    assert!(code == 2 && error.contains("train, val, test"), "{error}");
    let (code, error) = failure(&["--dataset", "folder:.", "--method", "farneback", "--crop", "1600"]);
    assert!(code == 2 && error.contains("WIDTHxHEIGHT"), "{error}");
}

#[test]
fn folders_that_cannot_be_scored_say_why() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = folder(dir.path());
    let (code, error) = failure(&["--dataset", &dataset, "--method", "farneback"]);
    assert!(
        code == 1 && error.contains(&dir.path().display().to_string()) && error.contains("img1"),
        "{error}"
    );

    make_pairs(dir.path(), 2);
    let (code, error) = failure(&["--dataset", &dataset, "--method", "farneback", "--crop", "1200x1600"]);
    assert!(code == 1 && error.contains("1200x1600") && error.contains("120x96"), "{error}");

    std::fs::write(dir.path().join("p1_flow.flo"), b"PIEH").unwrap();
    let (code, error) = failure(&["--dataset", &dataset, "--method", "farneback"]);
    assert!(code == 1 && error.contains("p1_flow.flo"), "{error}");
    let output = eval(&["--dataset", &dataset, "--method", "farneback", "--keep-going"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("1 pair,"), "the other pair is still scored");
    assert!(String::from_utf8_lossy(&output.stderr).contains("1 of 2 pairs"));
}

#[test]
fn frames_without_truth_cannot_be_scored() {
    let dir = tempfile::tempdir().unwrap();
    let frames = dir.path().join("frames");
    std::fs::create_dir(&frames).unwrap();
    for i in 0..2 {
        write_image_png(&frames.join(format!("{i}.png")), &frame(i as f32)).unwrap();
    }
    let (code, error) = failure(&["--dataset", &folder(dir.path()), "--method", "farneback"]);
    assert!(code == 1 && error.contains("true flow"), "{error}");
}

#[test]
fn saved_flows_score_as_the_method_that_made_them() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 3);
    let dataset = folder(dir.path());
    let flows = dir.path().join("flows").display().to_string();
    let common = ["--dataset", &dataset, "--crop", "64x48", "--json"];
    let scores = |more: &[&str]| -> serde_json::Value {
        let run = eval(&[&common[..], more].concat());
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        serde_json::from_slice(&run.stdout).unwrap()
    };
    let estimated = scores(&["--method", "My way:farneback", "--limit", "2", "--save-flow", &flows]);
    let read = scores(&["--method", &format!("files:{flows}/My way"), "--limit", "2"]);
    for region in ["whole", "head"] {
        assert_eq!(estimated["methods"][1][region], read["methods"][1][region]);
    }
    assert_eq!(
        (&read["methods"][1]["name"], &read["methods"][1]["pairs"][0]["seconds"]),
        (&"My way".into(), &().into())
    );
    assert_eq!((&estimated["limit"], &estimated["split"]), (&2.into(), &"all".into()));
    assert_eq!(estimated["made_by"][0]["method"], "farneback");
    let command = estimated["command"].as_str().unwrap();
    assert!(command.starts_with("srflow eval") && command.contains("'My way:farneback'"), "{command}");

    let (code, error) = failure(&["--dataset", &dataset, "--method", &format!("files:{flows}/My way")]);
    assert!(code == 1 && error.contains("1 of 3 pairs") && error.contains("p2"), "{error}");
    let again = ["--dataset", &dataset, "--method", "My way:farneback", "--save-flow", &flows];
    let (code, error) = failure(&again);
    assert!(code == 1 && error.contains("My way exists; give --force"), "{error}");
    let (code, error) = failure(&["--dataset", &dataset, "--method", "tvl1", "--out", "scores.json"]);
    assert!(code == 2 && error.contains("expected a folder"), "{error}");
    let flow = crate::srflow()
        .args(["flow", "--method", "files:flows", "a.png", "b.png", "-o", "c.flo"])
        .output()
        .unwrap();
    let error = String::from_utf8_lossy(&flow.stderr);
    assert!(flow.status.code() == Some(2) && error.contains("only `srflow eval`"), "{error}");
}
