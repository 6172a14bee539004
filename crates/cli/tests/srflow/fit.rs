//! `srflow avatar fit` from a user's view.

use std::fs;
use std::path::Path;
use std::process::Output;

use srflow_avatar::capture::Capture;

use crate::{json, refuses, succeeds};

fn captured(folder: &Path) {
    let made = crate::srflow()
        .args(["avatar", "capture", "--cameras", "3", "--timesteps", "3", "--size", "110x160", "--out"])
        .arg(folder.join("capture"))
        .args(["--seed", "4", "--json"])
        .output();
    json(&made.unwrap());
}

fn fit(folder: &Path, more: &[&str]) -> Output {
    let mut command = crate::srflow();
    command.current_dir(folder).args(["avatar", "fit", "capture", "--out", "fitted"]).args(more);
    command.output().unwrap()
}

const PERSON: [&str; 4] = ["--model", "builtin", "--seed", "4"];

#[test]
fn a_captured_head_is_found_and_written_as_a_capture() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    captured(folder);
    let report = json(&fit(folder, &[&PERSON[..], &["--truth", "capture", "--json"]].concat()));
    let mesh = report["mesh_error"]["parts"].as_array().unwrap();
    let skin = mesh.iter().find(|part| part["part"] == "skin").unwrap();
    assert!(skin["mean_mm"].as_f64().unwrap() < 1.0, "{mesh:?}");
    assert_eq!((&report["timesteps"], &report["pictures"]), (&3.into(), &9.into()));
    assert_eq!(report["outliers"], 0, "{report}");
    for camera in report["cameras"].as_array().unwrap() {
        assert!(camera["median"].as_f64().unwrap() < 0.1, "{camera}");
    }
    let saved: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("fitted/fit.json")).unwrap()).unwrap();
    assert_eq!(saved, report);

    let (truth, fitted) =
        (Capture::read(&folder.join("capture")).unwrap(), Capture::read(&folder.join("fitted")).unwrap());
    let of_origin: Vec<f64> =
        report["origin"].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect();
    for (truth, fitted) in truth.views().iter().zip(fitted.views()) {
        assert_eq!(
            (truth.timestep, truth.camera_index, truth.split),
            (fitted.timestep, fitted.camera_index, fitted.split)
        );
        let moved = truth.camera.position() - fitted.camera.position() - glam::DVec3::from_slice(&of_origin);
        assert!(moved.length() < 1e-9, "{moved}");
    }
    assert_eq!(truth.image(&truth.views()[4]).unwrap(), fitted.image(&fitted.views()[4]).unwrap());
    assert_eq!(truth.mask(&truth.views()[4]).unwrap(), fitted.mask(&fitted.views()[4]).unwrap());
    let (truth, fitted) = (truth.parameters().unwrap(), fitted.parameters().unwrap());
    for (truth, fitted) in truth.poses.iter().zip(&fitted.poses) {
        assert!((truth.jaw - fitted.jaw).length() < 0.05, "{truth:?} {fitted:?}");
    }
    let sum: glam::Vec3 = fitted.poses.iter().map(|pose| pose.translation).sum();
    assert!(sum.length() < 1e-6, "{sum}");

    refuses(&fit(folder, &PERSON), 1, &["fitted/transforms.json exists", "--force"]);
    let no_truth = fit(folder, &[&PERSON[..], &["--force", "--truth", "fitted"]].concat());
    refuses(&no_truth, 1, &["--truth", "no capture.json"]);
    let text =
        succeeds(&fit(folder, &[&PERSON[..], &["--force", "--cameras", "8", "--photometric"]].concat()));
    assert!(text.contains("pictures: 3, cameras: 1;") && text.contains("One camera sees no scale"), "{text}");
    assert!(text.contains("colours of the face differ by"), "{text}");
    fs::remove_file(folder.join("capture/images/00001_08.png")).unwrap();
    let gone = fit(folder, &[&PERSON[..], &["--force", "--photometric"]].concat());
    refuses(&gone, 1, &["images/00001_08.png"]);
}

#[test]
fn landmarks_of_detectors_are_taken_and_mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    captured(folder);
    let landmarks = fs::read_to_string(folder.join("capture/landmarks.csv")).unwrap();
    // The front camera's as OpenFace would write them.
    let names = |axis: &str| (0..68).map(|n| format!(", {axis}_{n}")).collect::<String>();
    let mut table = format!("frame, confidence, success{}{}\n", names("x"), names("y"));
    for timestep in ["0", "1", "2"] {
        let rows: Vec<Vec<&str>> = landmarks.lines().map(|line| line.split(',').collect()).collect();
        let column = |column: usize| -> String {
            let of = rows.iter().filter(|row| row[0] == timestep && row[1] == "8");
            of.map(|row| format!(", {}", row[column])).collect()
        };
        let frame: u32 = timestep.parse::<u32>().unwrap() + 1;
        table += &format!("{frame}, 0.98, 1{}{}\n", column(3), column(4));
    }
    fs::write(folder.join("openface.csv"), table).unwrap();
    let report = json(&fit(folder, &[&PERSON[..], &["--landmarks-of", "8=openface.csv", "--json"]].concat()));
    assert_eq!((&report["landmarks"], &report["missing"]), (&(3 * 68).into(), &(6 * 68).into()));

    let with = |more: &[&str]| fit(folder, &[&PERSON[..], &["--force"], more].concat());
    refuses(&with(&["--landmarks-of", "9=openface.csv"]), 2, &["--landmarks-of 9=", "[", "8"]);
    refuses(&with(&["--landmarks-of", "openface.csv"]), 2, &["expected the number of a camera and a file"]);
    refuses(&with(&["--cameras", "77"]), 2, &["--cameras 77"]);
    refuses(&with(&["--landmarks", "openface.csv"]), 1, &["openface.csv", "timestep,camera,landmark,x,y"]);
    refuses(&with(&["--noise", "0"]), 2, &["--noise"]);
    fs::write(folder.join("empty.csv"), "timestep,camera,landmark,x,y\n").unwrap();
    refuses(&with(&["--landmarks", "empty.csv"]), 1, &["no picture has 6 landmarks or more"]);
    let over = crate::srflow()
        .current_dir(folder)
        .args(["avatar", "fit", "capture", "--out", "capture", "--force"])
        .args(PERSON)
        .output();
    refuses(&over.unwrap(), 2, &["another folder"]);
}
