//! Faces cut out of frames: by landmarks that are given, by a box, and found with MediaPipe's networks where they are at hand.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use srflow_core::{Image, Size};
use srflow_files::{read_flow, read_image, write_image_png};

use crate::frames::{write_frames, write_pairs};
use crate::{json, refuses, succeeds};

fn srflow(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).args(arguments).output().unwrap()
}

const EYES: &str = "left_eye_x,left_eye_y,right_eye_x,right_eye_y";

#[test]
fn landmarks_and_boxes_cut_the_frames_of_a_sequence_alike() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(dir, 0..3, Size::new(160, 120));
    // 32 px apart on a level line: a square of 80, from 24 left of the left eye and 28.8 above.
    fs::write(dir.join("face.csv"), format!("{EYES}\n64,58.8,96,58.8\n")).unwrap();
    let flow = |more: &[&str]| {
        srflow(dir, &[&["flow", "--method", "farneback", "0.png", "1.png", "2.png"], more].concat())
    };
    succeeds(&flow(&["-o", "upright", "--landmarks", "face.csv", "--save-crops", "crops"]));
    succeeds(&flow(&["-o", "boxed", "--face-box", "40,30,80x80"]));
    assert_eq!(fs::read(dir.join("upright/1.flo")).unwrap(), fs::read(dir.join("boxed/1.flo")).unwrap());
    let whole = read_image(&dir.join("1.png")).unwrap();
    assert_eq!(read_image(&dir.join("crops/1.png")).unwrap().pixels(), whole.crop(40, 30, 80, 80).pixels());
    assert!(!dir.join("upright/landmarks.csv").exists(), "they were given");
    refuses(&flow(&["-o", "x", "--face-box", "100,30,80x80"]), 1, &["100,30,80x80", "160x120"]);
    refuses(&flow(&["-o", "x", "--save-crops", "c"]), 2, &["--save-crops", "--face detect"]);
    fs::write(dir.join("none.csv"), format!("{EYES}\n")).unwrap();
    refuses(
        &flow(&["-o", "x", "--landmarks", "none.csv"]),
        1,
        &["none.csv", "a row of landmarks, found none"],
    );
}

#[test]
fn pairs_are_scored_in_the_box_about_their_face() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_pairs(&dir.join("set"), 2, Size::new(160, 120), 1.5);
    fs::write(dir.join("faces.csv"), format!("pair,{EYES}\np0,64,58,96,58\np1,20,40,52,40\n")).unwrap();
    let eval = |more: &[&str]| {
        srflow(dir, &[&["eval", "--dataset", "folder:set", "--method", "farneback"], more].concat())
    };
    let text = succeeds(&eval(&["--landmarks", "faces.csv"]));
    assert!(text.contains("2 pairs, cropped to the face, "), "{text}");
    let sized = json(&eval(&["--landmarks", "faces.csv", "--crop", "64x48", "--json"]));
    assert_eq!((&sized["at_faces"], &sized["crop"][0]), (&true.into(), &64.into()));
    fs::write(dir.join("one.csv"), format!("pair,{EYES}\np0,64,58,96,58\n")).unwrap();
    refuses(&eval(&["--landmarks", "one.csv"]), 1, &["p1: one.csv: no landmarks of p1; add a row for it"]);
    let left_out = eval(&["--landmarks", "one.csv", "--keep-going"]);
    assert_eq!(left_out.status.code(), Some(1));
    assert!(
        String::from_utf8_lossy(&left_out.stdout).contains("1 pair, cropped to the face"),
        "{left_out:?}"
    );
}

#[test]
fn networks_that_are_missing_or_others_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    write_frames(dir, 0..2, Size::new(64, 48));
    let flow = |more: &[&str]| {
        let arguments = ["flow", "--method", "farneback", "0.png", "1.png", "-o", "flow.flo"];
        srflow(dir, &[&arguments, more].concat())
    };
    let with = |models: &str| flow(&["--face", "detect", "--face-models", models]);
    refuses(&flow(&["--face", "find"]), 2, &["find", "detect"]);
    refuses(&flow(&["--face-index", "1"]), 2, &["--face"]);
    refuses(&flow(&["--face", "detect", "--face-box", "1,1,9x9"]), 2, &["--face-box"]);
    refuses(&with("nowhere"), 1, &["nowhere: opening"]);
    fs::create_dir_all(dir.join("empty")).unwrap();
    refuses(
        &with("empty"),
        1,
        &["empty: expected", "mediapipe==0.10.21", "no face_detection_short_range.tflite"],
    );
    fs::write(dir.join("text.whl"), "no archive").unwrap();
    refuses(
        &with("text.whl"),
        1,
        &["text.whl: expected the networks of MediaPipe", "a file that is no whole .whl"],
    );
    let other = include_bytes!("../../../face/tests/golden/operations.tflite");
    fs::create_dir_all(dir.join("other")).unwrap();
    let model = dir.join("other/face_detection_short_range.tflite");
    fs::write(&model, other).unwrap();
    refuses(&with("other"), 1, &["expected a network for 128x128 pixels of 3 channels, found 18x13"]);
    fs::write(&model, &other[..4000]).unwrap();
    refuses(&with("other"), 1, &["face_detection_short_range.tflite: the file is damaged at byte"]);
    assert!(!dir.join("flow.flo").exists());
}

/// MediaPipe's networks, if they are at hand.
pub fn models() -> Option<PathBuf> {
    let named = std::env::var_os("SRFLOW_FACE_MODELS").map(PathBuf::from);
    let installed = || {
        let find = "import mediapipe; print(mediapipe.__path__[0])";
        let found = Command::new("python3").args(["-I", "-c", find]).output().ok()?;
        let folder = PathBuf::from(String::from_utf8(found.stdout).ok()?.trim());
        folder.join("modules/face_landmark/face_landmark.tflite").exists().then_some(folder)
    };
    let found = named.or_else(installed);
    if found.is_none() {
        eprintln!("skipped: mediapipe: no package up to 0.10.21 is installed or named by SRFLOW_FACE_MODELS");
    }
    found
}

/// The 68 points in each row of a file, by the cells before them.
fn rows(file: &Path, keys: usize) -> Vec<(Vec<String>, Vec<[f64; 2]>)> {
    let text = fs::read_to_string(file).unwrap();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let points: Vec<f64> = cells[keys..].iter().map(|cell| cell.parse().unwrap()).collect();
        let points = points[..68].iter().zip(&points[68..]).map(|(x, y)| [*x, *y]).collect();
        (cells[..keys].iter().map(|cell| (*cell).to_owned()).collect(), points)
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn faces_of_clips_are_found_where_they_are() {
    let Some(models) = models() else { return };
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let synth =
        ["mer", "synth", "--out", "set", "--subjects", "2", "--clips", "3", "--side", "224", "--fps", "40"];
    succeeds(&srflow(dir, &synth));
    let models = models.to_str().unwrap();
    let features = |out: &str, more: &[&str]| {
        let arguments = ["mer", "features", "--data", "clips:set", "--method", "farneback", "--out", out];
        srflow(dir, &[&arguments, more].concat())
    };
    let detect = ["--face", "detect", "--face-models", models];
    succeeds(&features("found.npz", &detect));
    let found = rows(&dir.join("found.landmarks.csv"), 4);
    assert_eq!(found.len(), 6);

    // The renderer knows where the points are.
    let truth = rows(&dir.join("set/landmarks.csv"), 3);
    for (keys, points) in &found {
        let (_, true_points) =
            truth.iter().find(|(of, _)| of[..2] == keys[..2]).expect("landmarks of the clip");
        let eye = |points: &[[f64; 2]], first: usize| {
            [0, 1].map(|axis| points[first..first + 6].iter().map(|point| point[axis]).sum::<f64>() / 6.0)
        };
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let eyes = apart(eye(true_points, 36), eye(true_points, 42));
        for first in [36, 42] {
            let error = apart(eye(points, first), eye(true_points, first)) / eyes;
            assert!(error < 0.1, "{keys:?}: an eye is {error:.3} of their distance away");
        }
    }

    // Given as landmarks, they give the same features without the networks.
    succeeds(&features("given.npz", &["--landmarks", "found.landmarks.csv"]));
    let x = |file: &str| {
        let file = fs::File::open(dir.join(file)).unwrap();
        let mut archive = zip::ZipArchive::new(file).unwrap();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut archive.by_name("X.npy").unwrap(), &mut bytes).unwrap();
        bytes
    };
    assert_eq!(x("found.npz"), x("given.npz"));
}

#[test]
fn of_several_faces_one_is_chosen_and_none_is_said() {
    let Some(models) = models() else { return };
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let synth =
        ["mer", "synth", "--out", "set", "--subjects", "2", "--clips", "1", "--side", "224", "--fps", "40"];
    succeeds(&srflow(dir, &synth));
    let face = |subject: &str| {
        let clip = dir.join("set").join(subject).join("c01");
        let mut files: Vec<PathBuf> =
            fs::read_dir(clip).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        read_image(&files[0]).unwrap()
    };
    let (a, b) = (face("s01"), face("s02"));
    let both = Image::from_fn(448, 224, |x, y| if x < 224 { a.get(x, y) } else { b.get(x - 224, y) });
    let grey = Image::from_fn(300, 200, |x, y| [(x / 2) as u8, (y / 2) as u8, 90]);
    for (name, picture) in
        [("both.png", &both), ("again.png", &both), ("grey.png", &grey), ("grey2.png", &grey)]
    {
        write_image_png(&dir.join(name), picture).unwrap();
    }
    let models = models.to_str().unwrap();
    let flow = |first: &str, second: &str, more: &[&str]| {
        let arguments = ["flow", "--method", "farneback", "-o", "flow.flo", "--force", "--face", "detect"];
        srflow(dir, &[&arguments[..], &["--face-models", models, first, second], more].concat())
    };
    refuses(&flow("grey.png", "grey2.png", &[]), 1, &["no face is found", "--face-box"]);
    refuses(
        &flow("both.png", "again.png", &[]),
        1,
        &["2 faces are found, from left to right", "--face-index 1 to 2"],
    );
    refuses(&flow("both.png", "again.png", &["--face-index", "3"]), 1, &["--face-index 3: expected 1 to 2"]);
    for (index, left) in [("1", true), ("2", false)] {
        let text = succeeds(&flow("both.png", "again.png", &["--face-index", index]));
        assert!(text.contains("flow.landmarks.csv: landmarks of the face in the first frame"), "{text}");
        let nose = rows(&dir.join("flow.landmarks.csv"), 0)[0].1[30];
        assert_eq!(nose[0] < 224.0, left, "{nose:?}");
        let size = read_flow(&dir.join("flow.flo")).unwrap().size();
        assert!(size.width == size.height && (100..300).contains(&size.width), "{size:?}");
    }
}

#[test]
fn landmarks_of_frames_are_written_and_read_again() {
    let Some(models) = models() else { return };
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let synth =
        ["mer", "synth", "--out", "set", "--subjects", "1", "--clips", "1", "--side", "224", "--fps", "40"];
    succeeds(&srflow(dir, &synth));
    let clip = dir.join("set/s01/c01");
    let mut frames: Vec<PathBuf> = fs::read_dir(&clip).unwrap().map(|entry| entry.unwrap().path()).collect();
    frames.sort();
    fs::create_dir(dir.join("clip")).unwrap();
    for (number, frame) in (7..).zip(&frames[..3]) {
        fs::copy(frame, dir.join(format!("clip/{number}.png"))).unwrap();
    }
    let grey = Image::from_fn(224, 224, |x, y| [(x / 2) as u8, (y / 2) as u8, 90]);
    write_image_png(&dir.join("clip/10.png"), &grey).unwrap();
    let models = models.to_str().unwrap();
    let face =
        |input: &str, more: &[&str]| srflow(dir, &[&["face", input, "--face-models", models], more].concat());
    let report = json(&face("clip", &["-o", "face.csv", "--fps", "50", "--viz", "drawn", "--json"]));
    assert_eq!((&report["frames"], &report["with_face"]), (&4.into(), &3.into()));
    let text = fs::read_to_string(dir.join("face.csv")).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert!(
        lines[0].starts_with("frame,timestamp,success,confidence,x_0,") && lines[0].ends_with(",y_67"),
        "{text}"
    );
    assert!(lines[2].starts_with("8,0.0200,1,0."), "{}", lines[2]);
    assert!(lines[4].starts_with("10,0.0600,0,0,,"), "{}", lines[4]);
    let (plain, drawn) =
        (read_image(&dir.join("clip/8.png")).unwrap(), read_image(&dir.join("drawn/8.png")).unwrap());
    let changed = plain.pixels().iter().zip(drawn.pixels()).filter(|(a, b)| a != b).count();
    assert!((200..=68 * 9).contains(&changed), "{changed}");

    // Other commands read the file, and find the same face as by themselves.
    let flow = |out: &str, more: &[&str]| {
        let arguments = ["flow", "clip/7.png", "clip/8.png", "--method", "farneback", "-o", out];
        succeeds(&srflow(dir, &[&arguments, more].concat()))
    };
    flow("given.flo", &["--landmarks", "face.csv"]);
    flow("found.flo", &["--face", "detect", "--face-models", models]);
    let sizes = ["given.flo", "found.flo"].map(|file| read_flow(&dir.join(file)).unwrap().size());
    assert_eq!(sizes[0], sizes[1]);

    let mesh = json(&face("clip/7.png", &["-o", "mesh.csv", "--points", "mesh", "--json"]));
    assert_eq!(mesh["with_face"], 1);
    assert!(fs::read_to_string(dir.join("mesh.csv")).unwrap().starts_with("frame,success,confidence,x_0,"));
    refuses(&face("clip", &["-o", "face.csv"]), 1, &["face.csv exists", "--force"]);
    refuses(&face("clip", &["-o", "face.txt"]), 2, &["face.txt", ".csv"]);
    refuses(&face("clip", &["-o", "b.csv", "--fps", "0"]), 2, &["--fps"]);
    refuses(&face("clip", &["-o", "b.csv", "--blendshapes"]), 2, &["--blendshapes", "face_landmarker.task"]);
    refuses(&face("clip/10.png", &["-o", "none.csv"]), 1, &["no face was found in any frame"]);
}
