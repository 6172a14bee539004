//! A rendered dataset passes its check, and every change to it is detected.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use srflow_core::{FlowField, Labels};
use srflow_files::{read_flow, read_labels, write_flow, write_labels_png};
use srflow_render::check::check;
use srflow_render::generate::{Settings, generate};
use srflow_render::job::Request;

use crate::tiny;

fn render(dir: &Path) {
    let settings = Settings { backward: true, depth: true, regions: true, ..tiny::settings() };
    generate(&settings, Request::new(dir)).unwrap();
}

/// Every problem as `FILE: WHAT`, with paths relative to the dataset's folder.
fn problems(dir: &Path) -> Vec<String> {
    let report = check(dir, &|| {}).unwrap();
    let shown = |file: &Path| file.strip_prefix(dir).unwrap().display().to_string();
    report.problems.iter().map(|problem| format!("{}: {}", shown(&problem.file), problem.what)).collect()
}

/// Sets one value of a JSON file.
fn change(path: &Path, pointer: &str, value: Value) {
    let mut content: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    *content.pointer_mut(pointer).unwrap() = value;
    fs::write(path, content.to_string()).unwrap();
}

#[test]
fn every_change_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    render(dir);
    assert_eq!(problems(dir), [""; 0]);

    let record = "train/pairs/scene-0000/00001.json";
    let cases = [
        (record, "/frame1/camera/fx", Value::from(-1), "frame1: fx -1.0, expected"),
        (record, "/frame2/view/0", Value::from(77), "frame2: view"),
        (record, "/frame1/gaze/1", Value::from(0.7), "frame1: gaze"),
        (record, "/frame1/joints/root/3", Value::from(5), "frame1: root"),
        (record, "/frame2/frame", Value::from(9), "is of frames 1 and 9, expected 1 and 2"),
        (record, "/flow/histogram/0", Value::from(1_000_000), "histogram"),
        (record, "/flow/max", Value::from(900), "maximum flow of 900"),
        (
            "statistics.json",
            "/mean_magnitude",
            Value::from(1.5),
            "mean_magnitude 1.5, the records of all pairs give",
        ),
        ("statistics.json", "", Value::from("junk"), "statistics.json"),
        ("dataset.json", "/scenes", Value::Array(vec![]), "lists 0 scenes, expected 1"),
        ("dataset.json", "/scenes/0/pairs", Value::from(2), "scene-0000: pairs 2, expected 3"),
        ("dataset.json", "/rig/0/fx", Value::from(-1), "camera 1: fx -1.0, expected"),
    ];
    for (file, pointer, value, expected) in cases {
        let path = dir.join(file);
        let sound = fs::read(&path).unwrap();
        change(&path, pointer, value);
        let found = problems(dir);
        assert!(
            found.iter().any(|what| what.starts_with(file) && what.contains(expected)),
            "{expected}: {found:?}"
        );
        fs::write(&path, sound).unwrap();
    }

    let statistics = fs::read(dir.join("statistics.json")).unwrap();
    fs::remove_file(dir.join("statistics.json")).unwrap();
    assert!(problems(dir)[0].starts_with("statistics.json: the file is missing; `srflow render`"));
    fs::write(dir.join("statistics.json"), statistics).unwrap();

    let stray: [(PathBuf, &str); 3] = [
        (
            dir.join("train/frames/scene-0009/00000.png"),
            "train/frames/scene-0009: not a scene of this dataset",
        ),
        (dir.join("train/depths/notes.txt"), "train/depths: not a part of this dataset"),
        (
            dir.join("train/mask/scene-0000/notes.txt"),
            "train/mask/scene-0000/notes.txt: not a file of this dataset",
        ),
    ];
    for (path, expected) in &stray {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "x").unwrap();
        assert!(problems(dir).iter().any(|what| what.starts_with(expected)), "{expected}");
        fs::remove_file(path).unwrap();
        let _ = fs::remove_dir(path.parent().unwrap()); // fails, and stays, if it contains the dataset's own files
    }

    // A valid file with the wrong content.
    let path = dir.join("train/flow_backward/scene-0000/00001.npz16");
    let flow = read_flow(&path).unwrap();
    let moved = flow.pixels().iter().map(|[u, v]| [u + 7.0, v - 5.0]).collect();
    write_flow(&path, &FlowField::from_pixels(110, 160, moved).unwrap()).unwrap();
    let found = problems(dir);
    assert!(found.len() == 1 && found[0].contains("the flow does not explain the frames"), "{found:?}");
    write_flow(&path, &flow).unwrap();
    fs::copy(dir.join("train/depth/scene-0000/00000.png"), dir.join("train/depth/scene-0000/00002.png"))
        .unwrap();
    let found = problems(dir);
    assert!(found.len() == 1 && found[0].contains("depth and mask contradict each other"), "{found:?}");
}

#[test]
fn damaged_region_maps_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    render(dir);
    let name = "train/regions/scene-0000/00002.png";
    let path = dir.join(name);
    let sound = read_labels(&path).unwrap();
    let changed = |change: fn(&mut Labels)| {
        let mut map = sound.clone();
        change(&mut map);
        write_labels_png(&path, &map).unwrap();
        let found = problems(dir);
        assert_eq!(found.len(), 1, "{found:?}");
        found[0].clone()
    };
    // The corners show the background, the middle the head.
    let outside = changed(|map| map.set(0, 0, 1));
    assert_eq!(outside, format!("{name}: region map and mask contradict each other in 1 pixels"));
    let inside = changed(|map| map.set(55, 80, 0));
    assert_eq!(inside, format!("{name}: region map and mask contradict each other in 1 pixels"));
    let meaningless = changed(|map| map.set(55, 80, 6));
    assert!(
        meaningless.starts_with(&format!("{name}: pixel (55, 80): expected 0 (background)")),
        "{meaningless}"
    );
    let small = changed(|map| *map = map.crop(0, 0, 110, 159));
    assert!(
        small.starts_with(&format!("{name}: expected 110x160 as in dataset.json, found 110x159")),
        "{small}"
    );
    // A picture of colours is no region map, even of the right size.
    fs::copy(dir.join("train/frames/scene-0000/00002.png"), &path).unwrap();
    assert!(
        problems(dir)[0].starts_with(&format!("{name}: pixels: expected 8-bit grey")),
        "{:?}",
        problems(dir)
    );
    fs::remove_file(&path).unwrap();
    assert_eq!(problems(dir), [format!("{name}: the file is missing")]);
}

#[test]
fn a_pair_without_files_is_one_problem() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    render(dir);
    for split in ["train", "val", "test"] {
        _ = fs::remove_dir_all(dir.join(split));
    }
    let problems = problems(dir);
    assert_eq!(problems.len() as u64, check(dir, &|| {}).unwrap().pairs);
    assert!(
        problems.iter().all(|problem| problem.ends_with("json: all files of this pair are missing")),
        "{problems:?}"
    );
}
