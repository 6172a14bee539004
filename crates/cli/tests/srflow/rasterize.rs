//! `srflow rasterize` on generated Gaussians, and on broken input.

use std::fs;
use std::path::Path;
use std::process::Output;

use srflow_core::Size;
use srflow_files::{read_flow, read_image, read_mask, read_npy, read_npy_plane};
use srflow_splat::{Gaussians, write_ply};

use crate::{json, refuses, succeeds};

const CAMERA: &str = r#"{"width": 60, "height": 40, "fx": 50, "fy": 50, "cx": 29.5, "cy": 19.5,
    "w2c": [[1,0,0,0], [0,1,0,0], [0,0,1,1], [0,0,0,1]]}"#;

/// `count` red Gaussians, the first at `(x, 0, 0)`.
fn gaussians(x: f32, count: usize) -> Gaussians {
    Gaussians {
        positions: (0..count).map(|i| [x + 0.01 * i as f32, 0.0, 0.0].into()).collect(),
        scales: vec![[0.1; 3].into(); count],
        rotations: vec![Default::default(); count],
        opacities: vec![0.9; count],
        sh_degree: 0,
        sh: vec![[1.7, -1.7, -1.7]; count],
        antialiased: false,
    }
}

fn scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_ply(&folder.path().join("a.ply"), &gaussians(0.0, 2)).unwrap();
    write_ply(&folder.path().join("b.ply"), &gaussians(0.1, 2)).unwrap();
    write_ply(&folder.path().join("three.ply"), &gaussians(0.0, 3)).unwrap();
    fs::write(folder.path().join("cam.json"), CAMERA).unwrap();
    fs::write(folder.path().join("cam2.json"), CAMERA.replace("[0,1,0,0]", "[0,1,0,0.2]")).unwrap();
    folder
}

fn rasterize(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).arg("rasterize").args(arguments).output().expect("srflow runs")
}

#[test]
fn every_file_is_written_and_the_flow_is_the_motion() {
    let folder = scene();
    let arguments =
        ["a.ply", "--next", "b.ply", "--camera", "cam.json", "--out", "out", "--background", "255,128,0"];
    let report = json(&rasterize(folder.path(), &[&arguments[..], &["--json"]].concat()));
    assert_eq!((&report["gaussians"], &report["visible"]), (&2.into(), &2.into()));

    let out = folder.path().join("out");
    let image = read_image(&out.join("color.png")).unwrap();
    assert_eq!((image.size(), image.get(0, 0)), (Size::new(60, 40), [255, 128, 0]));
    assert!(image.get(30, 20)[0] > 240 && image.get(30, 20)[1] < 20);
    let color = read_npy(&out.join("color.npy")).unwrap();
    assert_eq!(color.shape, [40, 60, 3]);
    assert!((color.values[1] - 128.0 / 255.0).abs() < 1e-6);
    let alpha = read_npy_plane(&out.join("alpha.npy")).unwrap();
    let depth = read_npy_plane(&out.join("depth.npy")).unwrap();
    assert!((depth.get(30, 20) - 1.0).abs() < 1e-5 && depth.get(0, 0) == 0.0);
    let mask = read_mask(&out.join("mask.png")).unwrap();
    assert!(mask.get(30, 20) && !mask.get(0, 0));

    // Every centre moves by 0.1 at depth 1: 5 px.
    let flow = read_flow(&out.join("flow.flo")).unwrap();
    let normalized = read_flow(&out.join("flow_normalized.flo")).unwrap();
    assert!((flow.get(30, 20)[0] - 5.0 * alpha.get(30, 20)).abs() < 1e-4);
    assert!((normalized.get(30, 20)[0] - 5.0).abs() < 1e-4 && normalized.get(30, 20)[1].abs() < 1e-4);

    refuses(&rasterize(folder.path(), &arguments), 1, &["out/color.png exists; give --force"]);
    let paper = [&arguments[..], &["--force", "--pixel-convention", "paper"]].concat();
    succeeds(&rasterize(folder.path(), &paper));
    let normalized = read_flow(&out.join("flow_normalized.flo")).unwrap();
    assert!((normalized.get(30, 20)[0] - 5.0 * 59.0 / 60.0).abs() < 1e-4);
}

#[test]
fn the_camera_alone_may_move_or_nothing() {
    let folder = scene();
    let moved = ["a.ply", "--camera", "cam.json", "--camera-next", "cam2.json", "--out", "moved"];
    succeeds(&rasterize(folder.path(), &moved));
    let [u, v] = read_flow(&folder.path().join("moved/flow_normalized.flo")).unwrap().get(30, 20);
    assert!(u.abs() < 1e-4 && (v - 10.0).abs() < 1e-4, "({u}, {v})");

    succeeds(&rasterize(folder.path(), &["a.ply", "--camera", "cam.json", "--out", "still"]));
    let flow = read_flow(&folder.path().join("still/flow.flo")).unwrap();
    assert!(flow.pixels().iter().all(|flow| *flow == [0.0; 2]));
}

#[test]
fn broken_input_is_named() {
    let folder = scene();
    let dir = folder.path();
    fs::write(dir.join("cut.ply"), &fs::read(dir.join("a.ply")).unwrap()[..500]).unwrap();
    let cameras = [
        ("nokey.json", CAMERA.replace("\"fx\"", "\"f\""), "missing field `fx`"),
        ("text.json", "hello".to_owned(), "expected a camera with width, height, fx"),
        ("flat.json", CAMERA.replace("[0,1,0,0]", "[1,0,0,0]"), "not a rigid motion"),
        ("scaled.json", CAMERA.replace("[0,1,0,0]", "[0,2,0,0]"), "not a rigid motion"),
        ("empty.json", CAMERA.replace("60", "0"), "0x40"),
        ("huge.json", CAMERA.replace("60", "4000000000"), "4000000000x40"),
        ("negative.json", CAMERA.replace("60", "-60"), "invalid value"),
        ("focal.json", CAMERA.replace("\"fx\": 50", "\"fx\": 0"), "fx is 0"),
    ];
    let mut cases = vec![
        (vec!["cut.ply", "--camera", "cam.json"], "cut.ply", "file size"),
        (vec!["none.ply", "--camera", "cam.json"], "none.ply", "opening"),
        (vec!["cam.json", "--camera", "cam.json"], "cam.json", "magic"),
        (vec!["a.ply", "--camera", "none.json"], "none.json", "No such file"),
        (
            vec!["a.ply", "--next", "three.ply", "--camera", "cam.json"],
            "three.ply",
            "2 Gaussians and three.ply holds 3",
        ),
    ];
    for (name, text, reason) in &cameras {
        fs::write(dir.join(name), text).unwrap();
        cases.push((vec!["a.ply", "--camera", name], name, reason));
    }
    for (arguments, file, reason) in cases {
        refuses(&rasterize(dir, &[&arguments[..], &["--out", "out"]].concat()), 1, &[file, reason]);
        assert!(!dir.join("out").exists());
    }
    let usage = rasterize(dir, &["a.ply", "--camera", "cam.json", "--out", "out", "--background", "1,2,300"]);
    assert_eq!(usage.status.code(), Some(2));
}

#[test]
fn a_camera_is_chosen_among_those_of_a_file() {
    let folder = scene();
    let dir = folder.path();
    let camera = |name: &str, x: f64| {
        format!(
            r#"{{"id": 0, "img_name": "{name}", "width": 60, "height": 40, "position": [{x}, 0, -1], "fx": 50, "fy": 50,
                "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}"#
        )
    };
    let cameras = [camera("front", 0.0), camera("right", 0.1), camera("far", 9.0)].join(", ");
    fs::write(dir.join("cameras.json"), format!("[{cameras}]")).unwrap();

    let from_file = ["a.ply", "--camera", "cameras.json", "--out", "none"];
    refuses(&rasterize(dir, &from_file), 2, &["holds 3 cameras", "front, right, far"]);
    let left = [&from_file[..], &["--view", "left"]].concat();
    refuses(&rasterize(dir, &left), 2, &["no camera has the name `left`"]);

    let views = ["--camera", "cameras.json", "--view", "front", "--view-next", "1"];
    succeeds(&rasterize(dir, &[&["a.ply", "--out", "views", "--size", "120x80"], &views[..]].concat()));
    let flow = read_flow(&dir.join("views/flow_normalized.flo")).unwrap();
    // The camera moves 0.1 to the right at depth 1: at twice the size 10 px to the left.
    let [u, v] = flow.get(60, 40);
    assert!(flow.size() == Size::new(120, 80) && (u + 10.0).abs() < 1e-3 && v.abs() < 1e-3, "({u}, {v})");
    let stretched = [&["a.ply", "--out", "none", "--size", "120x120"], &views[..]].concat();
    refuses(&rasterize(dir, &stretched), 2, &["proportions"]);
}

/// The output of a moving camera is a dataset with exact flow.
#[test]
fn a_moving_camera_gives_frames_flow_and_masks() {
    let folder = scene();
    let dir = folder.path();
    let orbit = ["a.ply", "--orbit", "-6x3", "--size", "80x60", "--background", "white", "--json"];
    let report = json(&rasterize(dir, &[&orbit[..], &["--out", "turn"]].concat()));
    assert_eq!((&report["frames"], &report["width"]), (&3.into(), &80.into()));
    let first = read_image(&dir.join("turn/frames/000001.png")).unwrap();
    assert_eq!((first.size(), first.get(0, 0)), (Size::new(80, 60), [255; 3]));
    assert!(first.get(40, 30)[0] > first.get(40, 30)[1], "red in the middle");
    assert!(read_mask(&dir.join("turn/mask/000003.png")).is_ok());
    assert!(dir.join("turn/flow/000002.flo").exists() && !dir.join("turn/flow/000003.flo").exists());
    let eval = ["eval", "--dataset", "folder:turn", "--method", "files:turn/flow", "--json"];
    let scores = json(&crate::srflow().current_dir(dir).args(eval).output().unwrap());
    assert_eq!((&scores["pairs"], &scores["methods"][1]["whole"]["epe"]), (&2.into(), &0.0.into()));

    fs::write(
        dir.join("path.json"),
        r#"{"render_width": 40, "render_height": 30, "camera_path": [
        {"fov": 40, "camera_to_world": [1,0,0,0, 0,1,0,0, 0,0,1,2, 0,0,0,1]},
        {"fov": 40, "camera_to_world": [1,0,0,0.1, 0,1,0,0, 0,0,1,2, 0,0,0,1]}]}"#,
    )
    .unwrap();
    succeeds(&rasterize(dir, &["a.ply", "--path", "path.json", "--out", "path"]));
    assert!(read_flow(&dir.join("path/flow/000001.flo")).unwrap().get(20, 15)[0] < -1.0);

    for (arguments, reason) in [
        (&["a.ply", "--camera", "cam.json", "--out", "one.mp4"][..], "give --orbit or --path"),
        (&["a.ply", "--orbit", "360x8", "--out", "turn.png"], "expected a folder"),
        (&["a.ply", "--orbit", "360x1", "--out", "new"], "2 frames or more"),
        (&["a.ply", "--orbit", "360x8", "--next", "b.ply", "--out", "new"], "--next"),
    ] {
        refuses(&rasterize(dir, arguments), 2, &[reason]);
    }
    let again = rasterize(dir, &[&orbit[..], &["--out", "turn"]].concat());
    refuses(&again, 1, &["turn/frames exists; give --force"]);
}
