//! `srflow eval` on a generated folder, and on broken folders.

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::Value;
use srflow_core::{Labels, Mask, Size};
use srflow_files::{write_labels_png, write_mask_png};

use crate::frames::{write_frames, write_pairs};
use crate::{json, refuses, succeeds};

const SIZE: Size = Size::new(120, 96);
const SHIFT: f32 = 3.0;

fn make_pairs(dir: &Path, count: usize) {
    write_pairs(dir, count, SIZE, SHIFT);
    let head = Mask::from_fn(SIZE.width, SIZE.height, |x, y| (30..90).contains(&x) && (20..80).contains(&y));
    for pair in 0..count {
        write_mask_png(&dir.join(format!("p{pair}_mask.png")), &head).unwrap();
    }
}

fn eval(arguments: &[&str]) -> Output {
    crate::srflow().arg("eval").args(arguments).output().expect("srflow runs")
}

fn folder(dir: &Path) -> String {
    format!("folder:{}", dir.display())
}

#[test]
fn scores_are_printed_and_written() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 2);
    let dataset = folder(dir.path());
    let out = dir.path().join("scores");
    let out_text = out.display().to_string();
    let arguments = ["--dataset", &dataset, "--method", "farneback", "--crop", "64x48", "--out", &out_text];
    let text = succeeds(&eval(&arguments));
    for part in ["EPE ↓", "px1 ↑", "F1-ALL ↓", "WAUC ↑", "zero", "farneback", "64x48", "inside the head mask"]
    {
        assert!(text.contains(part), "{part} in {text}");
    }
    let json = json(&eval(&["--dataset", &dataset, "--method", "farneback", "--json"]));
    let epe = |method: usize, region: &str| json["methods"][method][region]["epe"].as_f64().unwrap();
    assert!((epe(0, "whole") - f64::from(SHIFT)).abs() < 1e-6);
    assert!(epe(1, "head") < 0.5, "{}", epe(1, "head"));

    let csv = fs::read_to_string(out.join("scores.csv")).unwrap();
    assert!(csv.starts_with("method,region,epe,px1,px3,px5,f1_all,wauc"), "{csv}");
    assert!(fs::read_to_string(out.join("report.html")).unwrap().contains("farneback"));
    assert!(fs::read_to_string(out.join("scores.tex")).unwrap().contains("\\toprule"));

    refuses(&eval(&arguments), 1, &["scores.txt", "--force"]);
    succeeds(&eval(&[&arguments[..], &["--force"]].concat()));
}

#[test]
fn scores_by_region_are_printed_and_written() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 2);
    let dataset = folder(dir.path());
    let out = dir.path().join("scores").display().to_string();
    let arguments = ["--dataset", &dataset, "--method", "farneback", "--regions"];
    refuses(&eval(&arguments), 1, &["2 of 2 pairs have no region map", "srflow render --regions"]);
    let parts = [
        "2 of 2 pairs have no true flow of the expression",
        "--expression-error",
        "--decompose",
        "srflow mer synth",
    ];
    let arguments_of_parts = ["--dataset", &dataset, "--method", "farneback", "--expression-error"];
    refuses(&eval(&arguments_of_parts), 1, &parts);
    let map = Labels::from_fn(SIZE.width, SIZE.height, |x, y| {
        match ((30..90).contains(&x), (20..80).contains(&y)) {
            (true, true) => 1 + (x / 12 % 5) as u8,
            _ => 0,
        }
    });
    for pair in 0..2 {
        write_labels_png(&dir.path().join(format!("p{pair}_regions.png")), &map).unwrap();
    }
    let text = succeeds(&eval(&[&arguments[..], &["--small-motion", "4", "--out", &out]].concat()));
    for part in [
        "2 pairs, mouth\n",
        "2 pairs, EPE by region\n",
        "small motion (true flow under 4 px)",
        "rim of the head",
    ] {
        assert!(text.contains(part), "{part:?} in {text}");
    }
    let scores: Value =
        serde_json::from_str(&fs::read_to_string(format!("{out}/scores.json")).unwrap()).unwrap();
    let regions = &scores["methods"][0]["regions"];
    for region in ["skin", "eyes", "mouth", "hair", "neck", "rim", "background", "small_motion"] {
        assert_eq!(regions[region]["epe"], f64::from(SHIFT), "{region}");
    }
    assert!(fs::read_to_string(format!("{out}/scores.csv")).unwrap().contains("\nfarneback,small_motion,"));

    fs::write(dir.path().join("p1_regions.png"), b"not a picture").unwrap();
    refuses(&eval(&arguments), 1, &["p1_regions.png"]);
    refuses(&eval(&[&arguments[..], &["--small-motion", "-1"]].concat()), 2, &["--small-motion", "positive"]);
}

#[test]
fn wrong_names_list_the_right_ones() {
    for (dataset, more, expected) in [
        ("folder:.", ["--method", "crystal-ball"].as_slice(), ["crystal-ball", "farneback"]),
        ("imagenet:.", &["--method", "farneback"], ["imagenet", "sintel"]),
        ("folder", &["--method", "farneback"], ["folder", "KIND:DIR"]),
        ("folder:.", &["--method", "farneback", "--split", "holdout"], ["holdout", "train, val, test"]),
        ("folder:.", &["--method", "farneback", "--crop", "1600"], ["1600", "WIDTHxHEIGHT"]),
    ] {
        refuses(&eval(&[&["--dataset", dataset], more].concat()), 2, &expected);
    }
}

#[test]
fn folders_that_cannot_be_scored_say_why() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = folder(dir.path());
    let score = |more: &[&str]| eval(&[&["--dataset", &dataset, "--method", "farneback"], more].concat());
    refuses(&score(&[]), 1, &[&dir.path().display().to_string(), "img1"]);

    make_pairs(dir.path(), 2);
    refuses(&score(&["--crop", "1200x1600"]), 1, &["1200x1600", "120x96"]);

    fs::write(dir.path().join("p1_flow.flo"), b"PIEH").unwrap();
    refuses(&score(&[]), 1, &["p1_flow.flo"]);
    let output = score(&["--keep-going"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("1 pair,"), "the other pair is still scored");
    assert!(String::from_utf8_lossy(&output.stderr).contains("1 of 2 pairs"));
}

#[test]
fn frames_without_truth_cannot_be_scored() {
    let dir = tempfile::tempdir().unwrap();
    write_frames(&dir.path().join("frames"), 0..2, SIZE);
    refuses(&eval(&["--dataset", &folder(dir.path()), "--method", "farneback"]), 1, &["true flow"]);
}

#[test]
fn saved_flows_score_as_the_method_that_made_them() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 3);
    let dataset = folder(dir.path());
    let flows = dir.path().join("flows").display().to_string();
    let common = ["--dataset", &dataset, "--crop", "64x48", "--json"];
    let scores = |more: &[&str]| -> Value { json(&eval(&[&common[..], more].concat())) };
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

    let scored = |more: &[&str]| eval(&[&["--dataset", &dataset, "--method"], more].concat());
    refuses(&scored(&[&format!("files:{flows}/My way")]), 1, &["1 of 3 pairs", "p2"]);
    refuses(&scored(&["My way:farneback", "--save-flow", &flows]), 1, &["My way exists; give --force"]);
    refuses(&scored(&["tvl1", "--out", "scores.json"]), 2, &["expected a folder"]);
    let flow = ["flow", "--method", "files:flows", "a.png", "b.png", "-o", "c.flo"];
    refuses(&crate::srflow().args(flow).output().unwrap(), 2, &["only `srflow eval`"]);
}

#[test]
fn a_figure_for_a_paper_shows_the_pairs_that_are_named() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 2);
    let dataset = folder(dir.path());
    let figure = dir.path().join("figure");
    let figure_text = figure.display().to_string();
    let arguments = ["--dataset", &dataset, "--method", "farneback", "My way:tvl1", "--figure", &figure_text];
    refuses(&eval(&[&arguments[..], &["--figure-pairs", "p7"]].concat()), 2, &["p7", "p0, p1"]);
    succeeds(&eval(&[&arguments[..], &["--figure-pairs", "p1"]].concat()));
    let mut files: Vec<String> = fs::read_dir(&figure)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    let names = ["truth", "flow-farneback", "flow-My-way", "frame1", "error-farneback", "error-My-way"];
    let pictures = names.iter().enumerate().map(|(number, name)| format!("{:02}-p1-{name}.png", number + 1));
    let figures = ["figure.pdf", "figure.svg"].map(str::to_owned);
    assert_eq!(files, pictures.chain(figures).collect::<Vec<_>>());
    let truth = srflow_files::read_image(&figure.join("01-p1-truth.png")).unwrap();
    assert_eq!(truth.size(), SIZE, "in full size");
    let svg = fs::read_to_string(figure.join("figure.svg")).unwrap();
    assert_eq!(svg.matches("<image ").count(), 6 + 2, "the pictures, the wheel and the ramp");
    for text in ["My way", "farneback", "Ground truth / Frame 1", "EPE "] {
        assert!(svg.contains(text), "{text}");
    }
}

#[test]
fn rows_of_a_table_come_from_a_file() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 1);
    let rows = dir.path().join("rows.toml");
    let text = "[[row]]\nname = \"Baseline\"\nmethod = \"farneback\"\n\n\
                [[row]]\nname = \"Gone\"\nmethod = \"skflow\"\nweights = \"gone.ckpt\"\n\n\
                [[row]]\nname = \"Ours\"\nmethod = \"tvl1\"\nimproves_on = \"Baseline\"\n";
    fs::write(&rows, text).unwrap();
    let (dataset, rows) = (folder(dir.path()), rows.display().to_string());
    let arguments = ["--dataset", &dataset, "--rows", &rows];
    refuses(&eval(&arguments), 1, &["1 of 3 rows", "gone.ckpt"]);
    let text = succeeds(&eval(&[&arguments[..], &["--skip-missing"]].concat()));
    for part in ["Gone: left out", "improvement in percent", "Ours against Baseline"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let (baseline, ours) = (text.find("  Baseline").unwrap(), text.find("  Ours").unwrap());
    assert!(baseline < ours, "in the order of the file");
    refuses(&eval(&["--dataset", &dataset, "--rows", "paper-table-99"]), 1, &["paper-table-2"]);
}
