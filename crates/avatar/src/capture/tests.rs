use std::fs;

use glam::{DMat3, DVec3, Quat, Vec3};
use serde_json::{Value, json};
use srflow_core::{Image, Size};
use srflow_files::{NpzArray, write_image_png, write_npz};
use srflow_splat::Camera;

use super::*;
use srflow_head::{HeadModel, HeadParameters, HeadPose, PoseParameters};

/// A camera a metre in front of the origin, `degrees` to the side, with a principal point off the centre.
fn camera(degrees: f64) -> Camera {
    let turn = DMat3::from_rotation_y(degrees.to_radians());
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let camera = Camera { cx: 12.0, cy: 34.0, ..Camera::centred(Size::new(40, 60), [80.0, 81.0]) };
    camera.placed(turn * facing, turn * DVec3::Z)
}

fn views(timesteps: u32, cameras: &[u32]) -> Vec<CaptureView> {
    let all: Vec<u32> = (0..timesteps).collect();
    let split = split_of(&all, cameras);
    let mut views = Vec::new();
    for timestep in all {
        for &camera_index in cameras {
            let name = format!("{timestep:05}_{camera_index:02}.png");
            views.push(CaptureView {
                split: split(timestep, camera_index),
                timestep,
                camera_index,
                camera: camera(5.0 * f64::from(camera_index)),
                image: Path::new("images").join(&name),
                mask: Some(Path::new("fg_masks").join(&name)),
                parameters: Some(format!("flame_param/{timestep:05}.npz").into()),
            });
        }
    }
    views
}

#[track_caller]
fn assert_same_views(found: &[CaptureView], expected: &[CaptureView]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        let (a, b) = (found.camera, expected.camera);
        assert!((a.camera_from_world - b.camera_from_world).to_cols_array().iter().all(|d| d.abs() < 1e-12));
        assert!((a.cx - b.cx).abs() < 1e-12 && (a.cy - b.cy).abs() < 1e-12, "{a:?}");
        assert_eq!(&CaptureView { camera: b, ..found.clone() }, expected);
    }
}

#[test]
fn a_capture_survives_writing_and_reading() {
    let folder = tempfile::tempdir().unwrap();
    let written = views(10, &[0, 3, 8, 9]);
    write_transforms(folder.path(), &written).unwrap();
    let capture = Capture::read(folder.path()).unwrap();
    assert_same_views(capture.views(), &written);
    assert_eq!((capture.timesteps().len(), capture.camera_indices()), (10, vec![0, 3, 8, 9]));
    assert_eq!(CaptureSplit::ALL.map(|split| capture.of(split).count()), [21, 7, 12]);
    for split in CaptureSplit::ALL {
        fs::remove_file(folder.path().join(format!("transforms_{split}.json"))).unwrap();
    }
    assert_same_views(Capture::read(folder.path()).unwrap().views(), &written);
}

/// VHAP, `export_as_nerf_dataset.py`, `split_json`: ceil(0.7 T) timesteps for training, camera 8 held out, else the last.
#[test]
fn splits_are_those_of_vhap() {
    for (timesteps, for_training) in [(1, 1), (2, 2), (3, 3), (4, 3), (10, 7), (11, 8), (30, 21), (101, 71)] {
        let all: Vec<u32> = (0..timesteps).collect();
        let split = split_of(&all, &[1, 8, 12]);
        let tested = all.iter().filter(|&&t| split(t, 1) == CaptureSplit::Test).count();
        assert_eq!(timesteps as usize - tested, for_training, "{timesteps}");
        assert_eq!((split(0, 8), split(0, 12)), (CaptureSplit::Val, CaptureSplit::Train));
        assert_eq!(split_of(&all, &[1, 12])(0, 12), CaptureSplit::Val, "the last camera without an eighth");
        assert_eq!(split_of(&all, &[8])(0, 8), CaptureSplit::Train, "a single camera is not held out");
    }
}

/// What the loaders compute from the file: `readCamerasFromTransforms` of GaussianAvatars (rotation, translation and field of
/// view), and `NeRFDataset` of VHAP (its intrinsics, with rows counted from the bottom).
#[test]
fn the_loaders_of_gaussian_avatars_and_vhap_find_their_keys_and_conventions() {
    let folder = tempfile::tempdir().unwrap();
    let written = views(4, &[0, 8]);
    write_transforms(folder.path(), &written).unwrap();
    let text = fs::read_to_string(folder.path().join("transforms_train.json")).unwrap();
    let train: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&train["timestep_indices"], &train["camera_indices"]), (&json!([0, 1, 2]), &json!([0])));
    let frame = &train["frames"][1];
    let mut keys: Vec<&str> = frame.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    let mut expected = "timestep_index timestep_index_original timestep_id camera_index camera_id cx cy fl_x fl_y h w \
                        camera_angle_x camera_angle_y transform_matrix file_path fg_mask_path flame_param_path"
        .split(' ')
        .collect::<Vec<_>>();
    expected.sort_unstable();
    assert_eq!(keys, expected);
    for key in ["cx", "cy", "fl_x", "fl_y", "h", "w", "camera_angle_x", "camera_angle_y"] {
        assert_eq!(train[key], frame[key], "{key} at the root");
    }
    assert_eq!((&frame["file_path"], &frame["timestep_index"]), (&json!("images/00001_00.png"), &json!(1)));
    // The centre of pixel (12, 34): from the left and top edges 12.5 and 34.5, so from the bottom 60 - 34.5.
    assert_eq!((&frame["cx"], &frame["cy"]), (&json!(12.5), &json!(25.5)));
    let angle = frame["camera_angle_x"].as_f64().unwrap();
    assert!((40.0 / (2.0 * (angle / 2.0).tan()) - 80.0).abs() < 1e-9, "{angle}");
    let rows: Vec<Vec<f64>> = serde_json::from_value(frame["transform_matrix"].clone()).unwrap();
    let column = |at: usize| DVec3::new(rows[0][at], rows[1][at], rows[2][at]);
    let rotation = DMat3::from_cols(column(0), -column(1), -column(2)).transpose(); // camera from world
    let point = DVec3::new(0.05, 0.02, 0.1);
    let seen = rotation * (point - column(3));
    let (pixel, depth) = written[0].camera.project(point).unwrap();
    assert!((seen.z - depth).abs() < 1e-12);
    assert!((80.0 * seen.x / seen.z + 12.5 - 0.5 - pixel.x).abs() < 1e-9);
    assert!((81.0 * seen.y / seen.z + (60.0 - 25.5) - 0.5 - pixel.y).abs() < 1e-9);
}

#[test]
fn combined_sequences_lie_beside_their_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (sequence, union) = (folder.path().join("074_EMO-1"), folder.path().join("UNION"));
    for dir in [&sequence.join("images"), &sequence.join("fg_masks"), &union] {
        fs::create_dir_all(dir).unwrap();
    }
    write_image_png(&sequence.join("images/00000_00.png"), &Image::filled(40, 60, [9, 8, 7])).unwrap();
    write_image_png(&sequence.join("fg_masks/00000_00.png"), &Image::filled(40, 60, [51; 3])).unwrap();
    let mut frames = views(1, &[0]);
    let CaptureView { image, mask, .. } = &mut frames[0];
    for path in [image, mask.as_mut().unwrap()] {
        *path = Path::new("../074_EMO-1").join(&*path);
    }
    write_transforms(&union, &frames).unwrap();
    fs::remove_file(union.join("transforms_val.json")).unwrap();
    let capture = Capture::read(&union).unwrap();
    let view = &capture.views()[0];
    assert_eq!(capture.image(view).unwrap().get(3, 4), [9, 8, 7]);
    assert_eq!(capture.mask(view).unwrap().unwrap().pixels()[5], 0.2);
    write_image_png(&sequence.join("images/00000_00.png"), &Image::filled(20, 30, [9, 8, 7])).unwrap();
    let error = capture.image(view).unwrap_err().to_string();
    assert!(
        error.contains("40x60 (WIDTHxHEIGHT), as its camera") && error.contains("found 20x30"),
        "{error}"
    );
}

/// A capture whose `transforms_train.json` was changed is refused with these words.
#[track_caller]
fn refuses(change: impl FnOnce(&mut Value), parts: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    write_transforms(folder.path(), &views(4, &[0, 8, 9])).unwrap();
    let path = folder.path().join("transforms_train.json");
    let mut train: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut train);
    fs::write(&path, train.to_string()).unwrap();
    let error = Capture::read(folder.path()).unwrap_err().to_string();
    for part in parts {
        assert!(error.contains(part), "`{part}` is not in: {error}");
    }
}

#[test]
fn broken_captures_are_refused_with_a_reason() {
    let cameras = |train: &mut Value| train["camera_indices"] = json!([0, 8, 9]);
    refuses(cameras, &["transforms_train.json", "camera_indices", "8, of which no picture is listed"]);
    let timesteps = |train: &mut Value| train["timestep_indices"] = json!([0, 1]);
    refuses(timesteps, &["timestep_indices", "all 3 of the pictures", "2, without 2"]);
    refuses(|train| train["timestep_indices"] = json!("x"), &["frames with timestep_index"]);
    refuses(|train| train["frames"][0]["timestep_index"] = json!(-1), &["frames with timestep_index"]);
    refuses(|train| train["frames"][0]["camera_index"] = json!(8), &["camera_indices"]);
    let twice = |train: &mut Value| {
        let first = train["frames"][0].clone();
        train["frames"].as_array_mut().unwrap().push(first);
    };
    refuses(twice, &["each picture once", "timestep 0 of camera 0 a second time", "in train"]);
    let of_test = |train: &mut Value| {
        train["frames"][0]["timestep_index"] = json!(3);
        train["timestep_indices"] = json!([0, 1, 2, 3]);
    };
    refuses(of_test, &["transforms_test.json", "each picture once"]);
    let empty = tempfile::tempdir().unwrap();
    let error = Capture::read(empty.path()).unwrap_err().to_string();
    assert!(error.contains("transforms_train.json or transforms.json"), "{error}");
}

/// Negates columns of the poses in a list of pictures.
fn negate(transforms: &mut Value, columns: &[usize]) {
    for frame in transforms["frames"].as_array_mut().unwrap() {
        for row in frame["transform_matrix"].as_array_mut().unwrap() {
            for &column in columns {
                row[column] = json!(-row[column].as_f64().unwrap());
            }
        }
    }
}

#[test]
fn cameras_that_cannot_be_rendered_are_refused() {
    let entry = |row: usize, column: usize, value: Value| {
        move |train: &mut Value| train["frames"][0]["transform_matrix"][row][column] = value
    };
    refuses(entry(0, 0, json!(2.0)), &["images/00000_00.png", "not a rigid motion"]);
    refuses(entry(0, 3, Value::Null), &["transforms_train.json"]);
    refuses(entry(3, 3, json!(2.0)), &["a fourth of 0 0 0 1"]);
    let few = |train: &mut Value| train["frames"][0]["transform_matrix"] = json!([[1, 0, 0, 0]]);
    refuses(few, &["3 rows of 4 numbers"]);
    refuses(|train| negate(train, &[0]), &["images/00000_00.png", "mirrors the world"]);
    refuses(|train| train["frames"][0]["fl_x"] = json!(-1.0), &["focal length"]);
    refuses(|train| train["frames"][0]["w"] = json!(1e9), &["at most"]);
}

#[test]
fn cameras_with_the_axes_of_opencv_are_recognized() {
    let folder = tempfile::tempdir().unwrap();
    write_transforms(folder.path(), &views(2, &[0, 8])).unwrap();
    for split in CaptureSplit::ALL {
        let path = folder.path().join(format!("transforms_{split}.json"));
        let mut transforms: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        negate(&mut transforms, &[1, 2]);
        fs::write(&path, transforms.to_string()).unwrap();
    }
    Capture::read(folder.path()).expect("any world, where no head is said to be at its origin");
    fs::write(folder.path().join(CANONICAL_NAME), "").unwrap();
    let error = Capture::read(folder.path()).unwrap_err().to_string();
    assert!(error.contains("OpenGL") && error.contains("4 of 4 cameras that look away"), "{error}");
}

#[test]
fn parameters_survive_writing_and_reading() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flame_param.npz");
    let model = HeadModel::builtin(3);
    let mut pose = HeadPose {
        expressions: (0..model.expressions.len()).map(|i| 0.01 * i as f32).collect(),
        translation: Vec3::new(0.01, -0.02, 0.03),
        ..HeadPose::default()
    };
    for joint in 0..model.joints.len() {
        *pose.joint_mut(joint) = Quat::from_scaled_axis(Vec3::new(0.1, 0.2 * joint as f32, -0.3));
    }
    pose.offset = vec![Vec3::Y; 7];
    let still = (vec![0.0; model.expressions.len()], vec![Vec3::ZERO; 7]);
    let rest = HeadPose { expressions: still.0, offset: still.1, ..HeadPose::default() };
    let written = HeadParameters {
        shape: vec![0.5, -1.0],
        static_offset: vec![Vec3::splat(0.001); 7],
        poses: [&pose, &rest].map(|pose| PoseParameters::of(&model, pose)).to_vec(),
    };
    for of_avatar in [false, true] {
        written.write(&path, 7, of_avatar).unwrap();
        let read = HeadParameters::read(&path).unwrap();
        assert_eq!(read, written);
        let back = read.poses[0].pose(&model);
        for joint in 0..model.joints.len() {
            let (a, b) = (back.joint(joint), pose.joint(joint));
            assert!((a - b).length() < 1e-6, "joint {joint}: {a} {b}");
        }
        assert_eq!((&back.expressions, back.translation), (&pose.expressions, pose.translation));
    }
    let error = written.check(&model).unwrap_err().to_string();
    assert!(error.contains("shape: the parameters have 2, the head model builtin has 0"), "{error}");
    // As many offsets as vertices, or as FLAME has without VHAP's teeth.
    let with_offsets = |count| {
        let offsets =
            HeadParameters { shape: Vec::new(), static_offset: vec![Vec3::ONE; count], poses: Vec::new() };
        offsets.check(&model).map_err(|error| error.to_string())
    };
    assert!([0, 5023, model.template.len()].into_iter().all(|count| with_offsets(count).is_ok()));
    assert!(with_offsets(7).unwrap_err().starts_with("static_offset: the parameters have 7, the head model"));
}

#[test]
fn joints_without_a_role_have_their_own_array() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flame_param.npz");
    let mut model = HeadModel::builtin(3);
    (model.joints[1].role, model.joints[2].role) = (None, None);
    let turns: Vec<Quat> = (0..5).map(|i| Quat::from_rotation_y(0.1 * (i + 1) as f32)).collect();
    let pose = HeadPose { joints: turns.clone(), ..HeadPose::default() };
    let poses = vec![PoseParameters::of(&model, &pose); 2];
    HeadParameters { poses, ..HeadParameters::default() }.write(&path, 0, false).unwrap();
    let back = HeadParameters::read(&path).unwrap().poses[1].pose(&model);
    for (joint, turn) in turns.iter().enumerate() {
        assert!((back.joint(joint) - *turn).length() < 1e-6, "joint {joint}");
    }
}

#[test]
fn parameters_of_other_shapes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("00000.npz");
    let error = |name: &str, array: Option<NpzArray<'static>>| {
        let names = ["expr", "rotation", "neck_pose", "jaw_pose", "translation", "eyes_pose"];
        let all = names.into_iter().filter(|other| *other != name);
        let whole = all.map(|name| {
            let vectors = NpzArray::Float(&[2, 3], &[0.0; 6]);
            (name, if name == "eyes_pose" { NpzArray::Float(&[2, 6], &[0.0; 12]) } else { vectors })
        });
        let arrays: Vec<(&str, NpzArray)> = whole.chain(array.map(|array| (name, array))).collect();
        write_npz(&path, &arrays).unwrap();
        HeadParameters::read(&path).map(drop).map_err(|error| error.to_string())
    };
    let refuses = |name: &str, array: NpzArray<'static>, reason: &str| {
        let error = error(name, Some(array)).unwrap_err();
        assert!(error.contains(name) && error.contains(reason), "{error}");
    };
    assert_eq!(error("no_array", None), Ok(()));
    assert_eq!(error("rotation", None), Ok(()), "a missing array is zero");
    refuses("expr", NpzArray::Float(&[6], &[0.0; 6]), "(T, E)");
    refuses("expr", NpzArray::Float(&[0, 3], &[]), "one timestep or more");
    refuses("rotation", NpzArray::Float(&[3, 2], &[0.0; 6]), "(2, 3), as expr has 2 timesteps");
    refuses("translation", NpzArray::Float(&[3, 3], &[0.0; 9]), "as expr has 2 timesteps");
    refuses("neck_pose", NpzArray::Float(&[2, 3], &[f32::NAN; 6]), "finite numbers");
    refuses("shape", NpzArray::Float(&[2, 3], &[0.0; 6]), "of one head");
    refuses("static_offset", NpzArray::Float(&[2, 3, 1], &[0.0; 6]), "(1, V, 3)");
    refuses("other_joints", NpzArray::Float(&[2, 4], &[0.0; 8]), "(2, 3 J)");
    refuses("shape", NpzArray::Text(&[1], &["a"]), "'<U1'");
    fs::write(&path, "PK").unwrap();
    assert!(HeadParameters::read(&path).unwrap_err().to_string().contains("00000.npz"));
}

#[test]
fn landmarks_survive_writing_and_reading_and_may_be_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(LANDMARKS_NAME);
    let mut written = Landmarks::default();
    let mut face = [None; LANDMARK_COUNT];
    (face[0], face[67]) = (Some([1.25, -2.5]), Some([0.0, 801.125]));
    written.insert(3, 8, face);
    written.insert(3, 0, [Some([7.0, 7.5]); LANDMARK_COUNT]);
    written.write(&path).unwrap();
    let read = Landmarks::read(&path).unwrap();
    assert_eq!(read, written);
    assert_eq!((read.get(3, 8).unwrap()[67], read.get(4, 8)), (Some([0.0, 801.125]), None));
    for (text, reason) in [
        ("", "header"),
        ("timestep,camera,landmark,x,y\n0,0,68,1,1\n", "`0,0,68,1,1` in line 2"),
        ("timestep,camera,landmark,x,y\n0,0,1,nan,1\n", "finite"),
        ("timestep,camera,landmark,x,y\n0,0,1,1,1\n\n0,0,1,2,2\n", "a second one in line 4"),
        ("timestep,camera,landmark,x,y\n0,0,1,1\n", "line 2"),
    ] {
        fs::write(&path, text).unwrap();
        let error = Landmarks::read(&path).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    // As spreadsheets and pandas save it, with columns in another order.
    fs::write(&path, "\u{feff}Camera;Timestep;Landmark;X;Y\r\n8.0;3.0;67.0;0,5;801,125\r\n").unwrap();
    let saved = Landmarks::read(&path).unwrap();
    assert_eq!(saved.get(3, 8).unwrap()[67], Some([0.5, 801.125]));
}

#[test]
fn the_head_of_a_capture_is_recognized() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(HeadRecord::read(folder.path()).unwrap(), None);
    let mut model = HeadModel::builtin(1);
    let record = HeadRecord::new("builtin".into(), 1, &model);
    record.write(folder.path()).unwrap();
    let read = HeadRecord::read(folder.path()).unwrap().unwrap();
    assert_eq!(read, record);
    read.check(folder.path(), &HeadModel::builtin(2)).expect("all built-in heads have one topology");
    model.expressions.truncate(3);
    let error = read.check(folder.path(), &model).unwrap_err().to_string();
    assert!(error.contains("head.json") && error.contains("3 expressions"), "{error}");
    fs::write(folder.path().join(HEAD_NAME), "{}").unwrap();
    assert!(HeadRecord::read(folder.path()).unwrap_err().to_string().contains("head.json"));
}

/// A table of `count` landmarks: landmark n of frame f is at (n + f, 2 n) times `scale`.
fn table(columns: &str, rows: &[(&str, f64)], count: usize, scale: f64) -> String {
    let names = |axis: &str| (0..count).map(|n| format!(", {axis}_{n}")).collect::<String>();
    let mut text = format!("{columns}{}{}\n", names("x"), names("y"));
    for (start, frame) in rows {
        text += start;
        text.extend((0..count).map(|n| format!(", {}", (n as f64 + frame) * scale)));
        text.extend((0..count).map(|n| format!(", {}", 2.0 * n as f64 * scale)));
        text += "\n";
    }
    text
}

#[test]
fn tables_of_openface_and_mediapipe_are_read() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("faces.csv");
    let read = |text: &str| {
        fs::write(&path, text).expect("written");
        let mut landmarks = Landmarks::default();
        landmarks
            .add_table(&path, 3, Size::new(1000, 500))
            .map(|()| landmarks)
            .map_err(|error| error.to_string())
    };
    // The second face of frame 1 is surer; frame 2 failed; frame 4 has a hole.
    let rows = [("1,0.5,1", 1.0), ("1,0.9,1", 5.0), ("1,0.7,1", 9.0), ("2,0.0,0", 0.0), ("4,0.9,1", 2.0)];
    let openface = table("frame, confidence, success", &rows, 68, 1.0).replacen(", 67, ", ", nan, ", 1);
    let landmarks = read(&openface).expect("OpenFace");
    let at = |timestep: u32, landmark: usize| landmarks.get(timestep, 3).and_then(|face| face[landmark]);
    assert_eq!(at(0, 0), Some([5.0, 0.0]));
    assert_eq!(at(0, 67), Some([72.0, 134.0]));
    assert_eq!(at(1, 0), None);
    assert_eq!(at(2, 0), None);
    assert_eq!(at(3, 30), Some([32.0, 60.0]));
    assert!(landmarks.get(0, 0).is_none());

    for count in [468, 478] {
        let text = table("frame", &[("0", 0.0), ("7", 0.0)], count, 1.0 / 1024.0);
        let landmarks = read(&text).expect("MediaPipe");
        // The tip of the nose is vertex 4 of the mesh, the middle of the chin 152.
        for (landmark, vertex) in [(30, 4.0), (8, 152.0)] {
            let expected = [vertex / 1024.0 * 1000.0 - 0.5, 2.0 * vertex / 1024.0 * 500.0 - 0.5];
            assert_eq!(landmarks.get(7, 3).and_then(|face| face[landmark]), Some(expected));
        }
    }

    // Excel's "CSV UTF-8" begins with a byte order mark; spaces, quotes and the case of names do not matter.
    let saved = format!("\u{feff}{}", openface.replacen("frame, confidence", "\"Frame\", Confidence", 1));
    let plain = saved.replace(", ", ",");
    for text in [&saved, &plain.replace('\n', "\r\n"), &plain.replace(',', ";")] {
        assert!(read(text).expect("OpenFace") == landmarks, "{text}");
    }
    // srflow face counts frames from 0.
    let from_zero = read(&table("frame", &[("0", 3.0), ("1", 4.0)], 68, 1.0)).expect("srflow face");
    assert_eq!(from_zero.get(1, 3).and_then(|face| face[0]), Some([4.0, 0.0]));
    // MediaPipe's points in pixels, and rows that pandas numbers by fractions.
    let pixels = read(&table("frame", &[("7.0", 10.0)], 478, 1.0)).expect("pixels");
    assert_eq!(pixels.get(7, 3).and_then(|face| face[30]), Some([14.0, 8.0]));

    let fault = |text: &str, part: &str| {
        let error = read(text).expect_err(part);
        assert!(error.contains(part), "{error}");
    };
    fault("", "0 of x and 0 of y");
    fault(&table("frame", &[("1", 0.0)], 68, 1.0).replace("x_", "X_"), "no x_0 but X_0");
    fault(&table("timestep", &[("1", 0.0)], 68, 1.0), "a column `frame`");
    fault("left_eye_x,left_eye_y,right_eye_x,right_eye_y\n1,2,31,2\n", "the eyes alone");
    fault(&table("frame", &[], 67, 1.0), "67 of x and 67 of y");
    fault(&table("frame", &[("1", 0.0), ("x\u{1b}[31m", 0.0)], 68, 1.0), "x\\u{1b}[31m in line 3");
    fault(&table("frame", &[("-1", 0.0)], 68, 1.0), "line 2 counts to -2");
    fault(&table("frame", &[("1.5", 0.0)], 468, 1.0), "line 2 counts to 1.5");
    fault(&(table("frame", &[("1", 0.0)], 68, 1.0) + "2,1,1\n"), "3 in line 3");
}

#[test]
fn annotations_of_ibug_are_read() {
    let dir = tempfile::tempdir().expect("a folder");
    let body: String = (0..68).map(|n| format!("{}.5 {}\n", n + 1, 2 * n)).collect();
    let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).expect("written");
    let fault = |part: &str| {
        let error = Landmarks::read_points(dir.path()).expect_err(part).to_string();
        assert!(error.contains(part), "{error}");
    };
    fault("files like 00012_08.pts");
    write(
        "00012_08.pts",
        &format!("version: 1\nn_points:  68\n{{\n{}}}\n", body.replacen("3.5 4", "nan 4", 1)),
    );
    write("notes.txt", "not of landmarks");
    let landmarks = Landmarks::read_points(dir.path()).expect("annotations");
    let face = landmarks.get(12, 8).expect("a face");
    assert_eq!((face[0], face[2], face[67]), (Some([0.5, -1.0]), None, Some([67.5, 133.0])));
    assert_eq!(landmarks.len(), 1);
    write("12_8.pts", &format!("{{\n{body}}}\n"));
    fault("another file of the same timestep and camera");
    write("12_8.pts", &format!("{{\n{body}1 1\n}}\n"));
    fault("found 69");
    write("12_8.pts", "{\n1 2\n3 four\n}\n");
    fault("3 four in line 3");
    write("12_8.pts", "");
    write("a_8.pts", "");
    fs::remove_file(dir.path().join("12_8.pts")).expect("removed");
    fault("a_8");
}
