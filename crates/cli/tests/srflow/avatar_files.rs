//! Avatars in the files of GaussianAvatars: `--head avatar:DIR`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use srflow_avatar::Avatar;
use srflow_avatar::capture::HeadRecord;
use srflow_core::random::Key;
use srflow_files::{read_flow, read_mask, read_npy};
use srflow_head::{HeadParameters, Look, Moment, Motion, PoseParameters};

use crate::{json, refuses, succeeds};

const CAMERA: &str = r#"{"width": 110, "height": 160, "fx": 400, "fy": 400, "cx": 54.5, "cy": 79.5,
    "w2c": [[1,0,0,0], [0,-1,0,0.03], [0,0,-1,1], [0,0,0,1]]}"#;

/// A folder with the dressed built-in head of seed 5 in three poses, and a camera in front of it.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let dir = crate::binary().with_file_name("avatar-of-tests");
        let _ = fs::remove_dir_all(&dir); // of an earlier test run
        let avatar = Avatar::builtin(5).unwrap();
        let model = avatar.model();
        let motion = Motion::new(model, Look::default(), Key::new(3), 60, 24.0);
        let pose = |frame: usize| {
            let Moment { mut pose, .. } = motion.at(model, frame);
            pose.translation.x = 0.001 * frame as f32;
            PoseParameters::of(model, &pose)
        };
        let poses = [0, 24, 26].map(pose).to_vec();
        let parameters = HeadParameters { poses, ..HeadParameters::default() };
        let record = HeadRecord::new("builtin".into(), 5, model);
        avatar.write(&dir, &parameters, Some(&record)).unwrap();
        fs::write(dir.join("camera.json"), CAMERA).unwrap();
        dir
    })
}

fn run(arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder()).args(arguments).output().unwrap()
}

fn rasterize(arguments: &[&str], out: &Path) -> Output {
    let to = ["--camera", "camera.json", "--out", out.to_str().unwrap()];
    run(&[&["rasterize"], arguments, &to].concat())
}

/// The avatar in its own motion gives the flow and masks of the head that it was written from, and the pictures but for the light: colours in
/// files are those at rest.
#[test]
fn an_avatar_is_rasterized_in_its_own_motion() {
    let out = tempfile::tempdir().unwrap();
    let [read, made] = ["read", "made"].map(|name| out.path().join(name));
    let of = |head: &[&str], out: &Path| {
        let times = ["--timestep", "1", "--timestep-next", "2", "--json"];
        let report = json(&rasterize(&[head, &times].concat(), out));
        assert!(report["longest_flow"].as_f64().unwrap() > 0.5, "{report}");
    };
    of(&["--head", "avatar:."], &read);
    of(&["--head", "builtin", "--seed", "5", "--motion", "flame_param.npz"], &made);
    let colors = [&read, &made].map(|dir| read_npy(&dir.join("color.npy")).unwrap().values);
    let flows = [&read, &made].map(|dir| read_flow(&dir.join("flow.flo")).unwrap());
    let greatest = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let (color, flow) = (
        greatest(&colors[0], &colors[1]),
        greatest(flows[0].pixels().as_flattened(), flows[1].pixels().as_flattened()),
    );
    assert!(color < 0.25 && flow < 2e-2, "{color} {flow}");
    let apart: f32 = colors[0].iter().zip(&colors[1]).map(|(a, b)| (a - b).abs()).sum();
    // The light on the skin changes as the head moves, on the one that was made alone.
    assert!(apart / (colors[0].len() as f32) < 8e-3, "{apart}");
    let masks = [&read, &made].map(|dir| read_mask(&dir.join("mask.png")).unwrap());
    let differing = masks[0].pixels().iter().zip(masks[1].pixels()).filter(|(a, b)| a != b).count();
    assert!(differing <= 2, "{differing} pixels");
    assert!(masks[0].pixels().iter().filter(|inside| **inside).count() > 3000);
}

#[test]
fn action_units_pose_a_head_and_make_its_flow() {
    let out = tempfile::tempdir().unwrap();
    let units = ["--action-units", "6=0.5", "--action-units-next", "6=0.5,12_L=1,26=0.4", "--json"];
    let report = json(&rasterize(&[&["--head", "avatar:."], &units[..]].concat(), out.path()));
    let longest = report["longest_flow"].as_f64().unwrap();
    assert!((1.0..20.0).contains(&longest), "{report}");
    let unknown = rasterize(&["--head", "avatar:.", "--action-units", "99=1"], &out.path().join("never"));
    refuses(&unknown, 1, &["no action unit 99"]);
}

#[test]
fn a_dataset_is_rendered_from_an_avatar() {
    let out = tempfile::tempdir().unwrap();
    let render = |more: &[&str]| {
        let size = ["--scenes", "1", "--size", "110x160", "--splits", "1,0,0", "--depth", "--json", "--out"];
        run(&[&["render", "--head", "avatar:."], &size[..], &[out.path().to_str().unwrap()], more].concat())
    };
    refuses(
        &render(&["--frames", "3", "--motion", "own"]),
        2,
        &["--frames 3: expected less than the 3 timesteps"],
    );
    assert_eq!(json(&render(&["--frames", "2", "--motion", "own"]))["made"], 2);
    let train = out.path().join("train");
    for kind in ["occlusion", "mask", "alpha", "depth"] {
        let files = fs::read_dir(train.join(kind).join("scene-0000")).map_or(0, Iterator::count);
        assert!(files >= 2, "{kind}: {files} files");
    }
    json(&run(&["check", "--json", out.path().to_str().unwrap()]));
    refuses(&render(&["--frames", "2"]), 1, &["motion", "own", "--force"]);
}

#[test]
fn heads_and_motions_that_do_not_fit_are_refused() {
    let copy = tempfile::tempdir().unwrap();
    let out = copy.path().join("out");
    let refuses =
        |arguments: &[&str], code, parts: &[&str]| refuses(&rasterize(arguments, &out), code, parts);
    refuses(&["point_cloud.ply"], 1, &["bound to a triangle", "--head avatar:DIR"]);
    refuses(&["point_cloud.ply", "--head", "builtin"], 2, &["cannot be used with"]);
    refuses(&["--head", "avatar:nowhere"], 1, &["nowhere", "point_cloud.ply and flame_param.npz"]);
    refuses(
        &["--head", "avatar:.", "--timestep", "3"],
        2,
        &["--timestep 3: the motion has timesteps 0 to 2"],
    );
    refuses(&["--head", "builtin", "--motion", "own"], 2, &["--motion own", "avatar:DIR"]);
    refuses(&["--head", "builtin", "--motion", "point_cloud.ply"], 1, &["point_cloud.ply"]);
    for name in ["point_cloud.ply", "flame_param.npz"] {
        fs::copy(folder().join(name), copy.path().join(name)).unwrap();
    }
    let unnamed = format!("avatar:{}", copy.path().display());
    refuses(&["--head", &unnamed], 1, &["name no head model", "@flame:FILE"]);
    succeeds(&rasterize(&["--head", &format!("{unnamed}@builtin")], &out));
}
