//! `srflow demo` with small frames: the whole road, and what stops it before it starts.

use std::path::Path;
use std::process::Output;

fn demo(out: &Path, arguments: &[&str]) -> Output {
    let mut command = crate::srflow();
    command
        .args(["demo", "--size", "220x321", "--out"])
        .arg(out)
        .args(arguments)
        .output()
        .expect("srflow runs")
}

#[test]
fn the_whole_road_ends_in_one_page() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let run = demo(&out, &["--json"]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let result: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
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

    // What is there stays; the datasets are found by the commands that read datasets.
    let again = demo(&out, &[]);
    let error = String::from_utf8_lossy(&again.stderr).into_owned();
    assert_eq!(again.status.code(), Some(1));
    assert!(error.contains("report.html") && error.contains("--force"), "{error}");
    let dataset = format!("srflow:{}", out.join("clips").display());
    let eval = crate::srflow()
        .args(["eval", "--dataset", &dataset, "--method", "farneback", "--limit", "1"])
        .output()
        .unwrap();
    assert!(eval.status.success(), "{}", String::from_utf8_lossy(&eval.stderr));
}

#[test]
fn what_is_wrong_with_photographs_is_said_before_any_work() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let file = |name: &str| dir.path().join(name).display().to_string();
    std::fs::write(file("frame1.png"), b"not a picture").unwrap();
    let run = demo(&out, &["--pair", &file("frame1.png"), &file("frame2.png"), &file("flow.png")]);
    let error = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.code() == Some(1) && error.contains("frame1.png"), "{error}");
    let run = demo(&out, &["--kitti", &file("nowhere")]);
    let error = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.code() == Some(1) && error.contains("nowhere"), "{error}");
    assert!(!out.exists(), "nothing was made");
}
