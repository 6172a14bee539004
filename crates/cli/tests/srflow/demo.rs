//! `srflow demo` with small frames, end to end, and errors before it starts.

use std::path::Path;
use std::process::Output;

use crate::{json, refuses, succeeds};

fn demo(out: &Path, arguments: &[&str]) -> Output {
    let mut command = crate::srflow();
    command.args(["demo", "--size", "220x321", "--out"]).arg(out).args(arguments).output().unwrap()
}

#[test]
fn the_whole_road_ends_in_one_page() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let result = json(&demo(&out, &["--json"]));
    let epe = |method: usize| result["evaluations"]["in_motion"]["methods"][method]["whole"]["epe"].as_f64();
    let (zero, first_method) = (epe(0).unwrap(), epe(1).unwrap());
    assert!(zero > 0.05 && first_method < zero, "nothing moves ({zero}) or nothing is seen ({first_method})");

    let html = std::fs::read_to_string(out.join("report.html")).unwrap();
    for part in ["head 3", "AU 12", "lip corner puller", "farneback", "Occlusion", "Where the time went"] {
        assert!(html.contains(part), "{part} is missing");
    }
    assert!(html.len() < 15_000_000, "{} bytes", html.len());
    for outside in ["http:", "https:", "<script", "<link", "src=\"/"] {
        assert!(!html.contains(outside), "the page holds {outside}");
    }

    // Existing files are kept; the datasets are in the folders that other commands read.
    refuses(&demo(&out, &[]), 1, &["report.html", "--force"]);
    let dataset = format!("srflow:{}", out.join("clips").display());
    let eval = ["eval", "--dataset", &dataset, "--method", "farneback", "--limit", "1"];
    succeeds(&crate::srflow().args(eval).output().unwrap());
}

#[test]
fn errors_in_photographs_come_before_any_work() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let file = |name: &str| dir.path().join(name).display().to_string();
    std::fs::write(file("frame1.png"), b"not a picture").unwrap();
    let pair = ["--pair", &file("frame1.png"), &file("frame2.png"), &file("flow.png")];
    refuses(&demo(&out, &pair), 1, &["frame1.png"]);
    refuses(&demo(&out, &["--kitti", &file("nowhere")]), 1, &["nowhere"]);
    assert!(!out.exists(), "nothing was made");
}
