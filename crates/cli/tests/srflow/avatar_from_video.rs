//! `srflow avatar from-video`: what is refused, and a whole run where ffmpeg and MediaPipe's networks are at hand.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::face::models;
use crate::videos::programs_exist;
use crate::{json, notes, refuses, succeeds};

fn from_video(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).args(["avatar", "from-video"]).args(arguments).output().unwrap()
}

#[test]
fn what_is_no_video_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("clip.mp4"), "no video").unwrap();
    fs::create_dir(folder.join("models")).unwrap();
    let with =
        |more: &[&str]| from_video(folder, &[&["--out", "me", "--face-models", "models"], more].concat());
    refuses(&from_video(folder, &[]), 2, &["VIDEO", "--out"]);
    refuses(&with(&["clip.mp4", "--frames", "0"]), 2, &["--frames", "at least 1"]);
    refuses(&with(&["clip.mp4", "--focal", "nan"]), 2, &["--focal", "pixels"]);
    refuses(&with(&["none.mp4"]), 1, &["none.mp4: opening"]);
    refuses(&with(&["clip.mp4"]), 1, &["models: expected", "face_detection_short_range.tflite"]);
    refuses(&from_video(folder, &["clip.mp4", "--out", "me.png"]), 2, &["me.png: expected a folder"]);
}

#[test]
fn a_video_becomes_an_avatar_that_can_be_rendered() {
    let (Some(models), true) = (models(), programs_exist()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A person whose hair leaves the corner of the picture free.
    let synth = "mer synth --out set --subjects 1 --clips 1 --side 224 --fps 20 --seed 3".split(' ');
    succeeds(&crate::srflow().current_dir(folder).args(synth).output().unwrap());
    let encoded = Command::new("ffmpeg")
        .args([
            "-v",
            "error",
            "-framerate",
            "20",
            "-pattern_type",
            "glob",
            "-i",
            "set/s01/c01/*.png",
            "-pix_fmt",
            "yuv420p",
        ])
        .arg("clip.mp4")
        .current_dir(folder)
        .status();
    assert!(encoded.unwrap().success());
    let models = models.to_str().unwrap();
    let run = |video: &str, more: &[&str]| {
        let settings = ["--out", "me", "--frames", "9", "--iterations", "30", "--face-models", models];
        from_video(folder, &[&[video], &settings[..], more].concat())
    };
    refuses(&run("set/s01/c01", &[]), 1, &["c01", "a video"]);
    // Trainings write their progress to standard error.
    let reported = |output: Output| -> Value {
        notes(&output);
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let report = reported(run("clip.mp4", &["--focal", "600", "--json"]));
    assert_eq!((&report["stopped"], &report["focal"]), (&false.into(), &serde_json::json!([600.0, "given"])));
    assert_eq!(report["training"]["iteration"], 30, "{report}");
    assert!(report["face_psnr"].as_f64().unwrap() > 10.0, "{report}");
    // The face of the clip moves by parts of a pixel.
    assert!(report["motion"]["distance"].as_f64().unwrap() < 1.0, "{report}");
    let page = fs::read_to_string(folder.join("me/report.html")).unwrap();
    assert!(page.contains("as given") && page.contains("The fitted head") && page.contains("Not trained on"));
    assert!(page.contains("colours of the skin") && page.contains("flow measured in the video"));
    let chosen = fs::read_to_string(folder.join("me/frames.csv")).unwrap();
    assert_eq!(chosen.lines().count(), 10, "{chosen}");
    // The head is white in its mask, and the corner is not.
    let mask = srflow_files::read_image(&folder.join("me/fg_masks/00000_00.png")).unwrap();
    assert!(mask.get(112, 112)[0] > 200 && mask.get(221, 215)[0] < 50);

    // Its first step alone.
    let import = |more: &[&str]| {
        let arguments = ["avatar", "import", "clip.mp4", "--face-models", models, "--out", "capture"];
        crate::srflow().current_dir(folder).args(arguments).args(more).output().unwrap()
    };
    let text = succeeds(&import(&["--frames", "9", "--focal", "600"]));
    assert!(text.contains("9 pictures of one camera") && text.contains("600 px, as given"), "{text}");
    for file in ["landmarks.csv", "transforms.json", "images/00003_00.png"] {
        let [whole, alone] = ["me", "capture"].map(|of| fs::read(folder.join(of).join(file)).unwrap());
        assert_eq!(whole, alone, "{file}");
    }
    assert!(folder.join("capture/fg_masks/00008_00.png").exists());
    refuses(&import(&[]), 1, &["transforms.json exists", "--force"]);
    refuses(&import(&["--force", "--cameras", "x"]), 2, &["--cameras is a setting of pictures"]);

    let again = reported(run("clip.mp4", &["--focal", "600", "--json"]));
    assert_eq!(again["avatar"], report["avatar"]);
    refuses(&run("clip.mp4", &["--focal", "700"]), 2, &["video.json", "another --focal", "--force"]);
    let render =
        ["render", "--head", "avatar:me/avatar", "--out", "data", "--scenes", "1", "--splits", "1,0,0"];
    let more = ["--frames", "2", "--size", "96x128", "--json"];
    json(&crate::srflow().current_dir(folder).args(render).args(more).output().unwrap());
    succeeds(&crate::srflow().current_dir(folder).args(["check", "data"]).output().unwrap());
}
