//! `srflow avatar capture` from a user's view.

use std::fs;
use std::process::Output;

use crate::{fails, json, refuses};

const TINY: [&str; 6] = ["--cameras", "2", "--timesteps", "2", "--size", "110x160"];

fn capture(out: &std::path::Path, more: &[&str]) -> Output {
    crate::srflow().args(["avatar", "capture", "--out"]).arg(out).args(TINY).args(more).output().unwrap()
}

#[test]
fn a_capture_is_continued_and_its_cameras_can_be_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("capture");
    let stopped = capture(&out, &["--stop-after", "1"]);
    assert_eq!(stopped.status.code(), Some(75), "{stopped:?}");
    assert!(!out.join("transforms.json").exists());
    let report = json(&capture(&out, &["--json"]));
    assert_eq!(
        (&report["timesteps"], &report["made"], &report["complete"]),
        (&2.into(), &1.into(), &true.into())
    );
    for file in [
        "images/00001_08.png",
        "fg_masks/00000_01.png",
        "flame_param/00001.npz",
        "head.json",
        "landmarks.csv",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    refuses(&capture(&out, &["--seed", "2"]), 1, &["seed 1, requested is 2", "--force"]);
}

#[test]
fn wrong_arguments_are_wrong_usage() {
    let folder = tempfile::tempdir().unwrap();
    refuses(&capture(folder.path(), &["--noise=-1"]), 2, &["--noise -1: expected 0 to 100"]);
    let many = crate::srflow()
        .args(["avatar", "capture", "--out"])
        .arg(folder.path())
        .args(["--cameras", "17"])
        .output();
    refuses(&many.unwrap(), 2, &["--cameras 17: expected 1 to 16"]);
    fs::write(folder.path().join("mine.txt"), "mine").unwrap();
    let error = fails(&capture(folder.path(), &[]), 1);
    assert!(error.contains("is not empty and has no capture.json"), "{error}");
}
