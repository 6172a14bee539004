//! `srflow avatar`.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::{json, refuses, srflow, succeeds};

fn flame(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../head/tests/data/flame").join(name)
}

/// Positions and triangles of an OBJ file.
fn obj(path: &Path) -> (Vec<[f64; 3]>, usize) {
    let text = fs::read_to_string(path).unwrap();
    let positions = text.lines().filter_map(|line| line.strip_prefix("v ")).map(|line| {
        let numbers: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        numbers.try_into().unwrap()
    });
    (positions.collect(), text.lines().filter(|line| line.starts_with("f ")).count())
}

#[test]
fn meshes_of_the_builtin_head_have_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let mut sizes = Vec::new();
    for name in ["head.obj", "head.ply", "head.glb"] {
        let path = folder.path().join(name);
        let mesh = ["avatar", "mesh", "--model", "builtin", "--json", "-o"];
        let made = json(&srflow().args(mesh).arg(&path).output().unwrap());
        sizes.push((made["vertices"].clone(), made["triangles"].clone()));
        assert!(fs::metadata(&path).unwrap().len() > 100_000, "{name}");
        refuses(&srflow().args(mesh).arg(&path).output().unwrap(), 1, &[name, "--force"]);
    }
    let (positions, triangles) = obj(&folder.path().join("head.obj"));
    assert!(sizes.iter().all(|size| size.0 == positions.len() && size.1 == triangles), "{sizes:?}");
    // The nose of another person is elsewhere.
    let other = folder.path().join("other.obj");
    let mesh = ["avatar", "mesh", "--model", "builtin", "--seed", "9", "-o"];
    succeeds(&srflow().args(mesh).arg(&other).output().unwrap());
    assert_ne!(obj(&other).0, positions);
}

#[test]
fn a_flame_head_has_the_pose_of_its_timestep() {
    let folder = tempfile::tempdir().unwrap();
    let expected: Value = serde_json::from_slice(&fs::read(flame("expected.json")).unwrap()).unwrap();
    let model = format!("flame-toothless:{}", flame("python2.pkl").display());
    for (parameters, timestep) in [("parameters.npz", "1"), ("parameters.json", "0")] {
        let path = folder.path().join(format!("{parameters}.obj"));
        let mut mesh = srflow();
        mesh.args(["avatar", "mesh", "--model", &model, "--timestep", timestep, "-o"]).arg(&path);
        succeeds(&mesh.arg("--params").arg(flame(parameters)).output().unwrap());
        let (positions, triangles) = obj(&path);
        assert_eq!((positions.len(), triangles), (8, 8));
        for (v, position) in positions.iter().enumerate() {
            for axis in 0..3 {
                let error = position[axis] - expected["vertices"][v][axis].as_f64().unwrap();
                assert!(error.abs() < 4e-7, "{parameters}, vertex {v}: {error} m");
            }
        }
    }
}

#[test]
fn a_table_of_action_units_is_written_and_read_again_beside_its_model() {
    let folder = tempfile::tempdir().unwrap();
    let written = folder.path().join("table.json");
    let units = ["avatar", "units", "--model", "builtin", "--json"];
    let made = json(&srflow().args(units).arg("-o").arg(&written).output().unwrap());
    let smile = |made: &Value| {
        let units = made["units"].as_array().unwrap().clone();
        units.into_iter().find(|unit| unit["number"] == 12 && unit["side"] == "left").unwrap()
    };
    // Persons differ from the average head, whose units they are compared with.
    let left = smile(&made)["left_on_skin"].as_f64().unwrap();
    assert!(smile(&made)["motion_mm"].as_f64().unwrap() > 0.5 && left < 0.5, "{made}");
    refuses(&srflow().args(units).arg("-o").arg(&written).output().unwrap(), 1, &["table.json", "--force"]);
    refuses(&srflow().args(units).args(["-o", "table.txt"]).output().unwrap(), 2, &[".json"]);

    // A table beside a model is what its units are.
    fs::copy(flame("arrays.npz"), folder.path().join("head.npz")).unwrap();
    let model = format!("flame-toothless:{}", folder.path().join("head.npz").display());
    let listed = |model: &str| {
        json(&srflow().args(["avatar", "units", "--json", "--model", model]).output().unwrap())["listed"]
            .clone()
    };
    assert_eq!(listed(&model), 2, "the jaw alone, without landmarks");
    let beside = folder.path().join("action_units.json");
    let table =
        r#"{"model": "flame", "units": [{"number": 12, "side": "both", "expressions": {"NAME": 1.5}}]}"#;
    fs::write(&beside, table.replace("NAME", "expression002")).unwrap();
    assert_eq!(listed(&model), 1);
    fs::write(&beside, table.replace("NAME", "smile")).unwrap();
    let spoiled = srflow().args(["avatar", "units", "--model", &model]).output().unwrap();
    refuses(&spoiled, 1, &["action_units.json", "`smile` in action unit 12", "flame"]);
}

#[test]
fn wrong_arguments_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.obj").display().to_string();
    let model = format!("flame-toothless:{}", flame("arrays.npz").display());
    let (teeth, parameters) =
        (model.replace("-toothless", ""), flame("parameters.npz").display().to_string());
    let mesh = |arguments: &[&str]| {
        let mut command = srflow();
        command.args(["avatar", "mesh", "--model"]).args(arguments).output().unwrap()
    };
    refuses(&mesh(&["cube", "-o", &out]), 2, &["`cube`", "`builtin`", "`flame:FILE`"]);
    refuses(&mesh(&["builtin", "-o", "a.stl"]), 2, &["a.stl", ".obj, .ply, .glb"]);
    refuses(&mesh(&["flame:/nowhere.pkl", "-o", &out]), 1, &["/nowhere.pkl"]);
    refuses(&mesh(&[&teeth, "-o", &out]), 1, &["arrays.npz: 8 vertices", "5023"]);
    let late = [&model, "--params", &parameters, "--timestep", "2", "-o", &out].map(|text: &str| text);
    refuses(&mesh(&late), 2, &["--timestep 2", "timesteps 0 to 1"]);
    let misfit = ["builtin", "--params", &parameters, "-o", &out];
    refuses(&mesh(&misfit), 1, &["parameters.npz", "shape: the parameters have 300"]);
    assert!(!Path::new(&out).exists());
}

#[test]
fn landmarks_of_a_mesh_are_found_in_pictures_of_it() {
    let Some(models) = crate::face::models() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let run = |arguments: &[&str]| crate::srflow().current_dir(folder).args(arguments).output().unwrap();
    succeeds(&run(&["avatar", "mesh", "--model", "builtin", "--seed", "2", "-o", "head.glb"]));
    let dress = [
        "render",
        "--head",
        "gltf:head.glb",
        "--out",
        "set",
        "--scenes",
        "1",
        "--splits",
        "1,0,0",
        "--frames",
        "2",
    ];
    let dress = [&dress[..], &["--size", "64x96"]].concat();
    refuses(&run(&dress), 1, &["landmarks_68.txt", "srflow avatar landmarks"]);
    let models = models.to_str().unwrap();
    let find = |model: &str, more: &[&str]| {
        let arguments =
            ["avatar", "landmarks", "--model", model, "--face-models", models, "-o", "landmarks_68.txt"];
        run(&[&arguments, more].concat())
    };
    let report = json(&find("gltf:head.glb", &["--viz", "seen.png", "--json"]));
    assert_eq!(report["facing"], serde_json::json!([0.0, 0.0, 1.0]), "{report}");
    assert!(folder.join("seen.png").exists());

    // The sculptor knows where the eyes, the nose and the lips are.
    let model = srflow_head::HeadModel::builtin(2);
    let truth: Vec<glam::Vec3> = model.landmarks_on(&model.template).collect();
    let text = std::fs::read_to_string(folder.join("landmarks_68.txt")).unwrap();
    let place = |line: &str| -> glam::Vec3 {
        let cells: Vec<f32> = line.split_whitespace().map(|cell| cell.parse().unwrap()).collect();
        cells
            .as_chunks::<2>()
            .0
            .iter()
            .map(|[vertex, weight]| model.template[*vertex as usize] * *weight)
            .sum()
    };
    let found: Vec<glam::Vec3> = text.lines().map(place).collect();
    assert_eq!(found.len(), 68);
    for (points, most) in [(27..36, 0.008), (36..48, 0.006), (48..68, 0.008)] {
        let errors = points.clone().map(|point| found[point].distance(truth[point]));
        let mean = errors.sum::<f32>() / points.len() as f32;
        assert!(mean < most, "{points:?}: {mean} m");
    }
    succeeds(&run(&dress));
    refuses(&find("gltf:head.glb", &[]), 1, &["landmarks_68.txt exists"]);
}
