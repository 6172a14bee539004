//! Valid files of every format.

use std::fs;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use glam::DMat4;
use safetensors::tensor::{Dtype, TensorView};
use srflow_avatar::HeadSource;
use srflow_avatar::capture::{Capture, CaptureSplit, CaptureView, HeadRecord, write_transforms};
use srflow_avatar::train::{RunRecord, RunRequest, TrainConfig};
use srflow_core::{FlowField, Image, Labels, Size};
use srflow_files::{FlowFormat, RunMode, write_flow, write_flow_as, write_image_png, write_labels_png};
use srflow_head::{HeadModel, HeadParameters, PoseParameters};
use srflow_splat::{Camera, Gaussians, write_bound_ply, write_gaussians, write_ply};
use zip::write::SimpleFileOptions;

/// A valid file and the command that reads it: `FILE` stands for the mutated file, `DIR` for its folder.
pub(super) struct Sample {
    pub(super) name: &'static str,
    pub(super) bytes: Vec<u8>,
    pub(super) file: &'static str,
    pub(super) arguments: &'static [&'static str],
}

pub(super) const CONVERT: &[&str] = &["convert", "FILE", "DIR/out.npy", "--force"];
pub(super) const INSPECT: &[&str] = &["models", "inspect", "FILE"];
pub(super) const CAMERA: &str = r#"{"width": 24, "height": 16, "fx": 20, "fy": 20.5, "cx": 11.5, "cy": 7.5,
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
pub(super) const FACES_OF_FILE: &[&str] = &faces_by("FILE");
pub(super) const FACES_OF_FOLDER: &[&str] = &faces_by("DIR");
pub(super) const INTERVALS: &str = "video,onset,apex,offset,type\na,3,5,9,micro\nb,-2,,40,mae\n";
const SAMM_LONG: &str =
    "Subject,Filename,Onset,Apex,Offset,Type,Action Units\n6,a_1,566.4,-1,743.2,Macro,4\n";
const CASME3: &str =
    "Subject,Filename,Onset,Apex,Offset,AU,Expression type,Objective class\na,B,3,5,9,4,Micro-expression,I\n";
const CLIPS: &str =
    "clip,subject,onset,apex,offset,class,label\nc1,s1,1,3,5,negative,fear\nc2,s2,2,,9,surprise,x\n";

pub(super) fn samples(folder: &Path) -> Vec<Sample> {
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
    for (name, golden, file) in [
        ("compressed ply", "tiny.compressed.ply", "b.ply"),
        ("sog", "tiny.sog", "b.sog"),
        ("ksplat", "tiny-1.ksplat", "b.ksplat"),
        ("spz of Zstandard", "tiny-v4-lfu.spz", "b.spz"),
    ] {
        let bytes = fs::read(root().join("crates/splat/src/files/golden").join(golden)).unwrap();
        samples.push(Sample { name, bytes, file, arguments: rasterize });
    }
    for (name, file) in [("webp", "b.webp"), ("tiff", "b.tif")] {
        let bytes =
            fs::read(root().join("crates/files/tests/data/image").with_extension(&file[2..])).unwrap();
        samples.push(Sample { name, bytes, file, arguments: estimate });
    }
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
    fs::write(folder.join("intervals.csv"), INTERVALS).unwrap();
    let list = &["mer", "spot-score", "DIR/intervals.csv", "--truth", "csv:FILE"];
    samples.push(Sample { name: "intervals", bytes: INTERVALS.into(), file: "truth.csv", arguments: list });
    let samm = &["mer", "spot-score", "DIR/intervals.csv", "--truth", "samm-long:FILE"];
    samples.push(Sample { name: "samm-long", bytes: SAMM_LONG.into(), file: "samm.csv", arguments: samm });
    let casme3 = &["mer", "spot-score", "DIR/intervals.csv", "--truth", "casme3:FILE"];
    samples.push(Sample { name: "casme3", bytes: CASME3.into(), file: "casme3.csv", arguments: casme3 });
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
    let network = include_bytes!("../../../../face/tests/golden/operations.tflite");
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
    samples.push(Sample { name: "xls", bytes: old_workbook(), file: "a.xls", arguments: sheet });
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
    samples.extend(network_run(folder));
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

/// The files of a finished training of a network, which reads them again; without the hashes, which refuse all that is changed.
fn network_run(folder: &Path) -> Vec<Sample> {
    let config = format!(
        "[network]\narchitecture = \"raft-small\"\n[data]\ntrain = \"chairs:{}\"\ncrop = \"32x32\"\n\
         [augmentation]\nkind = \"none\"\n[training]\nsteps = 1\nbatch = 1\n",
        folder.join("generic").display()
    );
    fs::write(folder.join("network.toml"), config).unwrap();
    let run = folder.join("network");
    let trained = crate::srflow()
        .args(["train", "--config"])
        .arg(folder.join("network.toml"))
        .arg("--out")
        .arg(&run)
        .output();
    assert!(trained.unwrap().status.success());
    const CHECKPOINT: &str = "network/checkpoints/step-00000001";
    fs::remove_file(folder.join(CHECKPOINT).join("SHA256SUMS")).unwrap();
    let of_run = &["train", "--resume", "DIR"];
    let of_checkpoint = &["train", "--resume", "DIR/../.."];
    let sample = |(name, file, arguments)| Sample {
        name,
        bytes: fs::read(folder.join(file)).unwrap(),
        file,
        arguments,
    };
    [
        ("config of a network's run", "network/config.toml", of_run as &[_]),
        ("log of a network's run", "network/log.jsonl", of_run),
        ("state of a network's run", "network/checkpoints/step-00000001/state.json", of_checkpoint),
        (
            "optimizer of a network's run",
            "network/checkpoints/step-00000001/optimizer.safetensors",
            of_checkpoint,
        ),
        ("weights of a network's run", "network/checkpoints/step-00000001/model.safetensors", of_checkpoint),
    ]
    .map(sample)
    .into()
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
        camera: front_camera(Size::new(12, 16)),
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
fn front_camera(size: Size) -> Camera {
    Camera {
        camera_from_world: DMat4::from_cols_array(&[
            1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0, 1.0,
        ]),
        ..Camera::centred(size, [2.5 * size.height as f64; 2])
    }
}

/// The list of one picture of the built-in head, and its landmarks in both forms of tables.
fn tracked(folder: &Path) -> (String, String) {
    let camera = front_camera(Size::new(110, 160));
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
    let gaussians = Gaussians {
        positions: corners.to_vec(),
        scales: vec![[0.1; 3].into(); 3],
        rotations: vec![Default::default(); 3],
        opacities: vec![0.9; 3],
        sh_degree: 0,
        sh: vec![[1.0, 0.0, 0.5]; 3],
        antialiased: false,
    };
    write_ply(&folder.join("offset.ply"), &gaussians).unwrap();
    let offsets = fs::read(folder.join("offset.ply")).unwrap();
    let lam = archive(&[("p/skin.glb".to_owned(), bytes.clone()), ("p/offset.ply".to_owned(), offsets)]);
    let arguments = &["avatar", "mesh", "--model", "lam:FILE", "-o", "DIR/out.obj", "--force"];
    samples.push(Sample { name: "lam", bytes: lam, file: "lam.zip", arguments });
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
pub(super) const FACES: &str = "clip,subject,onset,apex,offset,class\n.,s1,1,2,2,negative\n";

/// Landmarks of the clip of [`FACES`]: the eyes alone.
pub(super) fn eyes() -> String {
    "subject,clip,left_eye_x,left_eye_y,right_eye_x,right_eye_y\ns1,.,8,6.5,16,7\n".to_owned()
}

/// The same as dlib's 68 points, with the number of the frame.
pub(super) fn dlib() -> String {
    let names: String = (0..68).map(|n| format!(",x_{n},y_{n}")).collect();
    let points: String = (0..68).map(|n| format!(",{},{}", 4 + n % 17, 2 + n / 6)).collect();
    format!("subject,clip,frame{names}\ns1,.,1{points}\n")
}

pub(super) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A workbook with SMIC's columns and one clip; `parts` override its own.
pub(super) fn workbook(parts: &[(&str, String)]) -> Vec<u8> {
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

/// The same in the records of old Excel: shared strings, a short number and a whole one.
fn old_workbook() -> Vec<u8> {
    let texts = ["Subject", "Filename", "OnsetF", "OffsetF", "Onset2F", "Emotion", "s01_ne_01", "negative"];
    let record = |kind: u16, content: &[u8]| {
        [&kind.to_le_bytes()[..], &u16::try_from(content.len()).unwrap().to_le_bytes(), content].concat()
    };
    let cell = |kind: u16, row: u8, column: u8, value: &[u8]| {
        record(kind, &[&[row, 0, column, 0, 0, 0][..], value].concat())
    };
    let text = |text: &str| [&[text.len() as u8, 0, 0][..], text.as_bytes()].concat();
    let table = [vec![8, 0, 0, 0, 8, 0, 0, 0], texts.iter().flat_map(|name| text(name)).collect()].concat();
    let (begin, end) = (record(0x809, &[0, 6]), record(0x00a, &[]));
    let header = (0..6).map(|at| cell(0x0fd, 0, at, &[at, 0, 0, 0]));
    let row = [
        cell(0x203, 1, 0, &1_f64.to_le_bytes()),
        cell(0x0fd, 1, 1, &[6, 0, 0, 0]),
        record(0x0bd, &[1, 0, 2, 0, 0, 0, 3 << 2 | 2, 0, 0, 0, 0, 0, 9 << 2 | 2, 0, 0, 0, 3, 0]),
        cell(0x0fd, 1, 5, &[7, 0, 0, 0]),
    ];
    let sheet: Vec<u8> = header.chain(row).flatten().collect();
    let at = begin.len() + 10 + 4 + table.len() + end.len();
    let listed = record(0x085, &[&(at as u32).to_le_bytes()[..], &[0, 0]].concat());
    let stream =
        [&begin, &listed, &record(0x0fc, &table), &end, &begin, &sheet, &end].map(Vec::as_slice).concat();
    let mut file = cfb::CompoundFile::create(Cursor::new(Vec::new())).unwrap();
    file.create_stream("/Workbook").unwrap().write_all(&stream).unwrap();
    file.flush().unwrap();
    file.into_inner().into_inner()
}

pub(super) fn archive(parts: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in parts {
        if archive.start_file(name.as_str(), SimpleFileOptions::default()).is_ok() {
            archive.write_all(bytes).unwrap();
        }
    }
    archive.finish().unwrap().into_inner()
}
