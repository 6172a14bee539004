//! `srflow mer run --save-model` and `srflow mer predict`, starting from an empty folder.

use std::fs;
use std::path::Path;
use std::process::Output;
use std::sync::LazyLock;

use serde_json::Value;

use crate::{fails, refuses, succeeds};

fn srflow(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).arg("mer").args(arguments).output().unwrap()
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    crate::json(&srflow(folder, &[arguments, &["--json"]].concat()))
}

/// Three subjects with three clips each, and a model of them.
static SET: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let size =
        ["--subjects", "3", "--clips", "3", "--side", "96", "--fps", "60", "--intensity", "2", "--seed", "2"];
    succeeds(&srflow(folder.path(), &[&["synth", "--out", "set"][..], &size].concat()));
    let run =
        ["run", "--data", "clips:set", "--method", "farneback", "--out", "results", "--save-model", "model"];
    succeeds(&srflow(folder.path(), &run));
    folder
});

#[test]
fn clips_get_classes_and_probabilities() {
    let set = SET.path();
    let card: Value =
        serde_json::from_str(&fs::read_to_string(set.join("model/model.json")).unwrap()).unwrap();
    assert_eq!((&card["flow"]["method"], &card["held_out"]["clips"]), (&"farneback".into(), &9.into()));
    assert_eq!(card["range"]["face_px"], serde_json::json!([96, 96]));

    let report = json(set, &["predict", "model", "clips:set", "--least-probability", "0", "--out", "of_set"]);
    let expressions = report["expressions"].as_array().unwrap();
    assert_eq!(expressions.len(), 9);
    for expression in expressions {
        let sum: f64 = expression["probabilities"].as_array().unwrap().iter().filter_map(Value::as_f64).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{expression}");
        assert_eq!(expression["class"], expression["truth"], "it was trained on these clips");
    }
    let table = fs::read_to_string(set.join("of_set/predictions.csv")).unwrap();
    let header = "source,subject,clip,type,onset,apex,offset,onset_s,class,most_probable,doubt,truth,\
                  probability_negative,probability_positive,probability_surprise";
    assert_eq!((table.lines().next(), table.lines().count()), (Some(header), 10));
    let page = fs::read_to_string(set.join("of_set/report.html")).unwrap();
    assert_eq!(page.matches("class=\"strip\"").count(), 9, "onset, apex and motion of each");

    let unsure = json(set, &["predict", "model", "clips:set", "--least-probability", "1", "--out", "unsure"]);
    let none = &unsure["expressions"][0];
    assert!(none["class"].is_null() && none["doubt"] == "no class is probable enough", "{none}");
}

#[test]
fn a_folder_of_frames_is_one_clip() {
    let set = SET.path();
    let clip = fs::read_dir(set.join("set/s01")).unwrap().map(|entry| entry.unwrap().path());
    let clip = clip.filter(|path| path.is_dir()).min().unwrap();
    let path = clip.to_str().unwrap();
    let report = json(set, &["predict", "model", path, "--clips", "--out", "one"]);
    let [expression] = &report["expressions"].as_array().unwrap()[..] else { panic!("{report}") };
    let number = |name: &str| expression[name].as_u64().unwrap();
    assert!(number("onset") < number("apex") && number("apex") <= number("offset"), "{expression}");
    assert!(expression["truth"].is_null());
    assert_eq!(fs::read_dir(&clip).unwrap().count() as u64, number("offset") - number("onset") + 1);
}

#[test]
fn expressions_of_a_video_are_spotted_and_classified() {
    let set = SET.path();
    let calm = ["--blinks", "0", "--glances", "0", "--speech", "0", "--drift", "0.2", "--intensity", "2"];
    let size = ["synth-long", "--out", "long", "--subjects", "1", "--minutes", "0.2", "--side", "96"];
    succeeds(&srflow(set, &[&size[..], &calm].concat()));
    let video = [
        "predict",
        "model",
        "long/s01",
        "--fps",
        "30",
        "--landmarks",
        "long/landmarks.csv",
        "--out",
        "video",
    ];
    let report = json(set, &video);
    let expressions = report["expressions"].as_array().unwrap();
    let spotted = fs::read_to_string(set.join("video/events.csv")).unwrap();
    assert!(!expressions.is_empty() && expressions.len() == spotted.lines().count() - 1, "{spotted}");
    for expression in expressions {
        assert!(expression["type"].is_string() && expression["onset_seconds"].is_f64(), "{expression}");
        assert!(expression["class"].is_string() || expression["doubt"].is_string(), "{expression}");
    }
    assert_eq!(json(set, &video), report, "the video is not spotted again");
}

#[test]
fn what_does_not_fit_is_refused() {
    let set = SET.path();
    let predict = |arguments: &[&str]| srflow(set, &[&["predict"], arguments, &["--out", "no"]].concat());
    refuses(&predict(&["nowhere", "clips:set"]), 1, &["nowhere", "save_model", "rendered", "found nothing"]);
    refuses(&predict(&["results", "clips:set"]), 1, &["model.json"]);
    refuses(&predict(&["model", "nothing.mp4"]), 1, &["nothing.mp4", "No such file"]);
    refuses(&predict(&["model", "nothing"]), 2, &["nothing", "no such file"]);
    refuses(&predict(&["model", "set/s01", "--least-probability", "2"]), 2, &["0 to 1, found 2"]);
    refuses(&predict(&["model"]), 2, &["VIDEO|FRAMES|KIND:DIR"]);
    let other = predict(&["model", "clips:set", "--model-method", "tvl1"]);
    refuses(&other, 1, &["from flow of farneback", "this is tvl1"]);
    assert!(!set.join("no").exists());

    let clip = fs::read_dir(set.join("set/s01")).unwrap().map(|entry| entry.unwrap().path());
    let clip = clip.filter(|path| path.is_dir()).min().unwrap();
    let clip = clip.to_str().unwrap();
    let twice = srflow(set, &["predict", "model", clip, clip, "--clips", "--out", "twice"]);
    refuses(&twice, 2, &["another clip is called"]);

    let run = |more: &[&str]| {
        let run = ["run", "--data", "clips:set", "--out", "results", "--force", "--save-model"];
        srflow(set, &[&run[..], more].concat())
    };
    refuses(&run(&["other", "--method", "farneback", "tvl1"]), 2, &["one --method, not 2"]);
    let again =
        ["run", "--data", "clips:set", "--out", "again", "--method", "farneback", "--save-model", "model"];
    let said = fails(&srflow(set, &again), 1);
    assert!(said.contains("model.json exists") && said.contains("--force"), "{said}");
}
