//! `srflow avatar import` from a user's view.

use std::fs;
use std::process::Output;

use srflow_avatar::capture::Capture;

use crate::{json, refuses};

#[test]
fn pictures_and_cameras_become_a_capture_that_can_be_fitted() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let run = |arguments: &[&str]| -> Output {
        crate::srflow().current_dir(folder).arg("avatar").args(arguments).output().unwrap()
    };
    let size = ["--cameras", "3", "--timesteps", "4", "--size", "110x160", "--seed", "4"];
    json(&run(&[&["capture", "--out", "made", "--json"], &size[..]].concat()));
    // As a person has them, without our names.
    let made = Capture::read(&folder.join("made")).unwrap();
    let numbers = made.camera_indices();
    for timestep in 0..4 {
        for &camera in &numbers {
            let from = |kind: &str| folder.join(format!("made/{kind}/{timestep:05}_{camera:02}.png"));
            let to = folder.join(format!("video/cam_{camera:02}"));
            fs::create_dir_all(&to).unwrap();
            fs::copy(from("images"), to.join(format!("frame_{timestep}.png"))).unwrap();
            fs::copy(from("fg_masks"), to.join(format!("alpha_{timestep}.png"))).unwrap();
        }
    }
    let cameras = fs::read_to_string(folder.join("made/transforms.json")).unwrap();
    let mut cameras: serde_json::Value = serde_json::from_str(&cameras).unwrap();
    for frame in cameras["frames"].as_array_mut().unwrap() {
        let camera = frame["camera_index"].as_u64().unwrap();
        frame["file_path"] = format!("calibration/{camera:02}.png").into();
    }
    fs::write(folder.join("calibration.json"), cameras.to_string()).unwrap();

    let patterns = ["--pattern", "cam_{camera}/frame_{timestep}", "--masks", "cam_{camera}/alpha_{timestep}"];
    let import = |more: &[&str]| {
        run(&[&["import", "video", "--cameras", "calibration.json"], &patterns[..], more].concat())
    };
    let report = json(&import(&["--out", "capture", "--json"]));
    assert_eq!(report["pictures"], 12);
    let found = report["cameras"].as_object().unwrap();
    assert!(
        numbers.iter().all(|camera| found[&camera.to_string()] == format!("{camera:02}")) && found.len() == 3
    );
    assert_eq!((&report["train"], &report["val"], &report["test"]), (&6.into(), &3.into(), &3.into()));
    let imported = Capture::read(&folder.join("capture")).unwrap();
    assert_eq!(made.views().len(), imported.views().len());
    for (made_view, view) in made.views().iter().zip(imported.views()) {
        let place =
            |view: &srflow_avatar::capture::CaptureView| (view.timestep, view.camera_index, view.split);
        assert_eq!(place(made_view), place(view));
        let moved = made_view.camera.camera_from_world - view.camera.camera_from_world;
        assert!(moved.to_cols_array().iter().all(|value| value.abs() < 1e-9));
        assert_eq!(made.image(made_view).unwrap(), imported.image(view).unwrap());
        assert_eq!(made.mask(made_view).unwrap(), imported.mask(view).unwrap());
    }
    let landmarks = ["--landmarks", "made/landmarks.csv", "--model", "builtin", "--seed", "4"];
    let fitted = json(&run(&[&["fit", "capture", "--out", "fitted", "--json"], &landmarks[..]].concat()));
    assert_eq!(fitted["pictures"], 12);

    refuses(&import(&["--out", "capture"]), 1, &["--force"]);
    refuses(&import(&["--out", "other", "--metres-per-unit", "0"]), 2, &["above 0"]);
    let pattern = ["import", "video", "--cameras", "calibration.json", "--out", "other", "--pattern"];
    refuses(&run(&[&pattern[..], &["cam_{camera}"]].concat()), 2, &["once each"]);
    refuses(&run(&[&pattern[..], &["{camera}/{timestep}"]].concat()), 1, &["found 24 files"]);
    let names = ["import", "made/images", "--cameras", "made/transforms.json", "--out", "other", "--pattern"];
    refuses(
        &run(&[&names[..], &["{timestep}_{camera}"]].concat()),
        1,
        &["found 00000_", "names of pictures; name each camera as `{camera}` matches it"],
    );
    assert!(!folder.join("other").exists());
    // A video in place of a folder.
    fs::write(folder.join("clip.mp4"), "").unwrap();
    refuses(&run(&["fit", "clip.mp4", "--model", "builtin", "--out", "other"]), 1, &["srflow avatar import"]);
    let render = crate::srflow()
        .current_dir(folder)
        .args(["render", "--head", "avatar:clip.mp4", "--out", "set"])
        .output();
    refuses(&render.unwrap(), 1, &["srflow avatar from-video"]);
}
