//! Files of Gaussians for other programs: `srflow convert`, `srflow avatar export`, and the mesh that goes with them.

use std::fs;
use std::path::Path;
use std::process::Output;

use glam::Vec3;
use serde_json::Value;
use srflow_files::read_image;
use srflow_head::{HeadModel, Side};
use srflow_splat::{Gaussians, read_gaussians, write_ply};

use crate::{json, refuses, srflow, succeeds};

/// A red Gaussian above a grey and a green one, where +y is up, with blue that is not the same from all sides.
fn upright() -> Gaussians {
    let colors = [[1.5, -1.5, -1.5], [-1.5, 1.5, -1.5], [0.0; 3]];
    Gaussians {
        positions: vec![Vec3::new(0.0, 0.3, 0.05), Vec3::new(0.02, -0.3, 0.0), Vec3::new(0.0, 0.0, 0.02)],
        scales: vec![Vec3::new(0.1, 0.05, 0.08); 3],
        rotations: [0.3, 0.5, -0.2].map(glam::Quat::from_rotation_z).to_vec(),
        opacities: vec![0.9, 0.8, 0.7],
        sh_degree: 1,
        sh: colors.into_iter().flat_map(|color| [color, [0.0; 3], [0.0, 0.0, -0.5], [0.0; 3]]).collect(),
        antialiased: true,
    }
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    srflow().current_dir(folder).args(arguments).output().unwrap()
}

/// Standard error of a run that succeeds.
#[track_caller]
fn noted(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// What is upright stays upright in every format, and comes back.
#[test]
fn convert_goes_round_the_formats_of_gaussians() {
    let folder = tempfile::tempdir().unwrap();
    let original = upright();
    write_ply(&folder.path().join("a.ply"), &original).unwrap();
    let read = |name: &str| read_gaussians(&folder.path().join(name)).unwrap();
    let made = json(&run(folder.path(), &["convert", "a.ply", "a.glb", "--json"]));
    assert_eq!(
        (&made["gaussians"], &made["sh_degree"], &made["antialiased"]),
        (&3.into(), &1.into(), &true.into())
    );
    assert_eq!(read("a.glb").positions, original.positions);
    assert!(read("a.glb").antialiased);
    let note = noted(&run(folder.path(), &["convert", "a.glb", "a.spz"]));
    assert!(note.starts_with("note: a.spz: a .spz file does not keep precision"), "{note}");
    let spz = read("a.spz");
    assert!(spz.antialiased && spz.positions[0].distance(original.positions[0]) < 1e-6);
    let note = noted(&run(folder.path(), &["convert", "a.spz", "a.splat"]));
    assert!(note.contains("the order of the Gaussians, spherical harmonics above degree 0"), "{note}");
    let down = read("a.splat").positions[0];
    assert!(down.distance(Vec3::new(0.0, -0.3, -0.05)) < 1e-6, "{down}");
    let said = succeeds(&run(folder.path(), &["convert", "a.splat", "back.ply"]));
    assert_eq!(said, "back.ply: 3 Gaussians with spherical harmonics of degree 0\n");
    assert!(read("back.ply").positions[0].distance(original.positions[0]) < 1e-6);

    // A scene where -y is up, and back.
    succeeds(&run(folder.path(), &["convert", "a.ply", "b.glb", "--ply-up", "-y"]));
    assert_eq!(read("b.glb").positions[0], Vec3::new(0.0, -0.3, 0.05));
    succeeds(&run(folder.path(), &["convert", "b.glb", "b.ply", "--ply-up=-y"]));
    assert_eq!(read("b.ply").positions, original.positions);
    assert_eq!(read("b.ply").sh, original.sh);
}

#[test]
fn every_format_is_rasterized_alike_and_upright() {
    let folder = tempfile::tempdir().unwrap();
    write_ply(&folder.path().join("a.ply"), &upright()).unwrap();
    for name in ["a.glb", "a.spz", "a.splat"] {
        noted(&run(folder.path(), &["convert", "a.ply", name]));
    }
    let picture = |name: &str| {
        let out = format!("{name}.out");
        succeeds(&run(folder.path(), &["rasterize", name, "--size", "60x60", "--out", &out]));
        read_image(&folder.path().join(out).join("color.png")).unwrap()
    };
    let expected = picture("a.ply");
    let brightest = |channel: usize| {
        let pixels = (0..60 * 60).map(|at| (at % 60, at / 60));
        pixels.max_by_key(|&(x, y)| expected.get(x, y)[channel]).unwrap().1
    };
    assert!(brightest(0) < 30 && brightest(1) > 30, "red is above green");
    for (name, most) in [("a.glb", 0), ("a.spz", 12), ("a.splat", 40)] {
        let found = picture(name);
        for (x, y) in (0..60 * 60).map(|at| (at % 60, at / 60)) {
            let (a, b) = (expected.get(x, y), found.get(x, y));
            // A .splat has no harmonic of degree 1, which is in blue.
            let channels = if name == "a.splat" { 0..2 } else { 0..3 };
            assert!(channels.clone().all(|c| a[c].abs_diff(b[c]) <= most), "{name} ({x}, {y}): {a:?} {b:?}");
        }
    }
    let next = ["rasterize", "a.splat", "--next", "a.splat", "--out", "flow"];
    refuses(&run(folder.path(), &next), 2, &["a.splat", "sorted by their size", ".ply"]);
}

#[test]
fn convert_does_not_mix_flow_and_gaussians() {
    let folder = tempfile::tempdir().unwrap();
    write_ply(&folder.path().join("a.ply"), &upright()).unwrap();
    let convert = |arguments: &[&str]| run(folder.path(), &[&["convert"], arguments].concat());
    refuses(&convert(&["a.ply", "a.flo"]), 2, &["a.flo: a.ply holds Gaussians", ".ply, .splat, .spz, .glb"]);
    refuses(&convert(&["a.flo", "b.ply"]), 2, &["b.ply: Gaussians are read from"]);
    refuses(&convert(&["a.ply", "b.glb", "--viz"]), 2, &["--viz draws a flow"]);
    refuses(&convert(&["a.ply", "b.glb", "--ply-up", "z"]), 2, &["expected y or -y"]);
    refuses(&convert(&["no.ply", "b.glb"]), 1, &["no.ply: opening"]);
    succeeds(&convert(&["a.ply", "b.glb"]));
    refuses(&convert(&["a.ply", "b.glb"]), 1, &["b.glb", "--force"]);
}

/// The JSON of a `.glb` file.
fn document(path: &Path) -> Value {
    let bytes = fs::read(path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).unwrap()
}

#[test]
fn a_head_is_exported_with_its_mesh_cameras_and_motion() {
    let folder = tempfile::tempdir().unwrap();
    let camera = r#"{"width": 60, "height": 40, "fx": 50, "fy": 50, "cx": 29.5, "cy": 19.5,
        "w2c": [[1,0,0,0], [0,-1,0,0], [0,0,-1,1], [0,0,0,1]]}"#;
    fs::write(folder.path().join("cam.json"), camera).unwrap();
    let export = |arguments: &[&str]| {
        run(folder.path(), &[&["avatar", "export", "--head", "builtin"], arguments].concat())
    };
    let made =
        json(&export(&["--animate", "3", "--fps", "10", "--camera", "cam.json", "--json", "-o", "a.glb"]));
    let scene = document(&folder.path().join("a.glb"));
    let names: Vec<&str> =
        scene["nodes"].as_array().unwrap().iter().map(|node| node["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["splats", "head", "cam"]);
    assert_eq!(scene["meshes"][1]["primitives"][0]["targets"].as_array().unwrap().len(), 2);
    let times = scene["animations"][0]["samplers"][0]["input"].as_u64().unwrap() as usize;
    assert!((scene["accessors"][times]["max"][0].as_f64().unwrap() - 0.2).abs() < 1e-6);
    let placed = &scene["nodes"][2]["matrix"];
    assert_eq!((&placed[14], &placed[10], &placed[5]), (&1.0.into(), &1.0.into(), &1.0.into()));
    let gaussians = read_gaussians(&folder.path().join("a.glb")).unwrap();
    assert_eq!(made["gaussians"], gaussians.len());
    let highest = gaussians.positions.iter().map(|p| p.y).fold(f32::MIN, f32::max);
    let nose = gaussians.positions.iter().map(|p| p.z).fold(f32::MIN, f32::max);
    assert!(highest > 0.05 && nose > 0.05, "upright, and looking along +z: {highest} {nose}");

    succeeds(&export(&["--no-mesh", "--action-units", "12=0.8", "-o", "smile.glb"]));
    assert_eq!(document(&folder.path().join("smile.glb"))["nodes"].as_array().unwrap().len(), 1);
    let smile = read_gaussians(&folder.path().join("smile.glb")).unwrap();
    assert!(smile.positions != gaussians.positions && smile.len() == gaussians.len());
    succeeds(&export(&["--ply-up", "-y", "--action-units", "12=0.8", "-o", "smile.ply"]));
    let mut turned = read_gaussians(&folder.path().join("smile.ply")).unwrap();
    turned.half_turn(srflow_splat::HalfTurn::X);
    assert_eq!(turned.positions, smile.positions);

    for (arguments, code, parts) in [
        (
            &["-o", "a.obj"][..],
            2,
            &["a.obj: expected a file ending in .ply, .splat, .spz, .glb", "avatar mesh"][..],
        ),
        (&["-o", "a.spz", "--camera", "cam.json"], 2, &["a.spz: only a .glb"]),
        (&["-o", "b.glb", "--animate", "1000"], 2, &["--animate: expected 2 to 256"]),
        (
            &["-o", "b.glb", "--animate", "10", "--timestep", "235"],
            2,
            &["--animate 10: the motion has 5 timesteps from 235 on"],
        ),
        (&["-o", "b.glb", "--timestep", "240"], 2, &["--timestep 240: the motion has timesteps 0 to 239"]),
        (&["-o", "b.glb", "--action-units", "99=1"], 1, &["99"]),
        (&["-o", "a.glb"], 1, &["a.glb", "--force"]),
    ] {
        refuses(&export(arguments), code, parts);
    }
    refuses(&run(folder.path(), &["avatar", "export", "-o", "b.glb"]), 2, &["--head"]);
}

#[test]
fn a_mesh_takes_action_units() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = ["avatar", "mesh", "--model", "builtin", "--action-units", "12=0.8,26=0.5", "-o", "smile.obj"];
    let said = succeeds(&run(folder.path(), &mesh));
    let model = HeadModel::builtin(1);
    let (triangles, vertices) = (model.triangles.len(), model.template.len());
    assert_eq!(said, format!("smile.obj: {triangles} triangles on {vertices} vertices\n"));
    let pose = model.pose_of_action_units(&[(12, Side::Both, 0.8), (26, Side::Both, 0.5)]).unwrap();
    let mut expected = Vec::new();
    model.vertices(&model.shaped(&[]), &pose, &mut expected);
    let text = fs::read_to_string(folder.path().join("smile.obj")).unwrap();
    let written = text.lines().filter_map(|line| line.strip_prefix("v "));
    let written: Vec<Vec3> = written
        .map(|line| Vec3::from_slice(&line.split(' ').map(|n| n.parse().unwrap()).collect::<Vec<f32>>()))
        .collect();
    assert_eq!(written, expected);
    let both = [&mesh[..], &["--params", "p.json", "--force"]].concat();
    refuses(&run(folder.path(), &both), 2, &["cannot be used with"]);
}
