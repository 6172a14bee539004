//! Meshes of other programs as heads: `--head obj:FILE`.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Output;

use srflow_files::read_npy;
use srflow_head::HeadModel;

use crate::{json, notes, refuses, succeeds};

fn run(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).args(arguments).output().unwrap()
}

/// Writes the built-in head as a mesh in these units, red to the left of the nose and blue to the right of it.
fn write_scan(folder: &Path, units_per_metre: f32) {
    let model = HeadModel::builtin(1);
    let mut obj = String::new();
    for vertex in &model.template {
        let [x, y, z] = (*vertex * units_per_metre).to_array();
        let color = if vertex.x > 0.0 { "1 0 0" } else { "0 0 1" };
        writeln!(obj, "v {x} {y} {z} {color}").unwrap();
    }
    for [a, b, c] in &model.triangles {
        writeln!(obj, "f {} {} {}", a + 1, b + 1, c + 1).unwrap();
    }
    fs::write(folder.join("scan.obj"), obj).unwrap();
    let mut landmarks = String::new();
    for (triangle, weights) in &model.landmarks[..68] {
        let corners = model.triangles[*triangle as usize].iter().zip(weights.to_array());
        let row: Vec<String> = corners.map(|(vertex, weight)| format!("{vertex} {weight}")).collect();
        writeln!(landmarks, "{}", row.join(" ")).unwrap();
    }
    fs::write(folder.join("landmarks_68.txt"), landmarks).unwrap();
}

#[test]
fn a_scan_in_its_own_colours_moves_by_action_units() {
    let folder = tempfile::tempdir().unwrap();
    write_scan(folder.path(), 1000.0);
    let rasterize = |more: &[&str]| {
        let fixed = ["rasterize", "--head", "obj:scan.obj", "--size", "80x100", "--out", "out", "--force"];
        run(folder.path(), &[&fixed, more].concat())
    };
    let noted = notes(&rasterize(&["--action-units", "26=0", "--action-units-next", "26=1,12=1"]));
    assert!(noted.contains("scan.obj") && noted.contains("taken as millimetres"), "{noted}");
    let flow = srflow_files::read_flow(&folder.path().join("out/flow.flo")).unwrap();
    let longest = flow.pixels().iter().map(|[u, v]| u.hypot(*v)).fold(0.0, f32::max);
    assert!((1.0..20.0).contains(&longest), "{longest}");
    // The subject's left is on the right of the picture.
    let color = read_npy(&folder.path().join("out/color.npy")).unwrap();
    let pixel = |x: usize, y: usize| &color.values[3 * (80 * y + x)..][..3];
    let (left, right) = (pixel(50, 55), pixel(30, 55));
    assert!(left[0] > 0.9 && left[2] < 0.1 && right[2] > 0.9 && right[0] < 0.1, "{left:?} {right:?}");
    // Without landmarks nobody knows where the face is.
    fs::remove_file(folder.path().join("landmarks_68.txt")).unwrap();
    let output = rasterize(&["--action-units", "26=1"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("no action unit 26"), "{output:?}");
    notes(&rasterize(&[]));
}

#[test]
fn a_scan_is_rendered_as_a_dataset() {
    let folder = tempfile::tempdir().unwrap();
    write_scan(folder.path(), 1.0);
    let scenes = ["--scenes", "1", "--splits", "1,0,0", "--frames", "2", "--size", "60x80", "--regions"];
    let render = [&["render", "--head", "obj:scan.obj", "--out", "set"], &scenes[..]].concat();
    succeeds(&run(folder.path(), &render));
    json(&run(folder.path(), &["check", "set", "--json"]));
    let missing = run(folder.path(), &["render", "--head", "obj:none.obj", "--out", "none"]);
    refuses(&missing, 1, &["none.obj"]);
}
