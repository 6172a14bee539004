//! `srflow mer data`, `synth`, `apex` and `strain`, starting from an empty folder.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::LazyLock;

use serde_json::Value;
use srflow_core::Size;
use srflow_files::{read_image, read_npy};

use crate::{fails, refuses, succeeds};

fn srflow(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).arg("mer").args(arguments).output().unwrap()
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    crate::json(&srflow(folder, &[arguments, &["--json"]].concat()))
}

/// Two subjects with two small clips each, rendered once.
static SET: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["synth", "--out", "set", "--subjects", "1", "--clips", "3", "--side", "96", "--fps", "40"];
    let report = json(folder.path(), &arguments);
    assert_eq!((&report["clips"], &report["made"]), (&3.into(), &3.into()));
    folder
});

/// The published annotation files, if they are next to the repository.
fn annotations() -> Option<PathBuf> {
    let here = std::env::current_dir().unwrap();
    let found = here.ancestors().map(|dir| dir.join("shared/data/me-annotations")).find(|dir| dir.is_dir());
    if found.is_none() {
        eprintln!("skipped: shared-data: no shared/data/me-annotations above {}", here.display());
    }
    found
}

#[test]
fn a_rendered_set_is_listed() {
    let set = SET.path();
    let report = json(set, &["data", "clips:set"]);
    let dataset = &report["datasets"][0];
    assert_eq!((&dataset["name"], &dataset["counts"]["total"]), (&"set".into(), &3.into()));
    assert_eq!((&dataset["missing_frames"], &dataset["without_apex"]), (&0.into(), &0.into()));
    assert_eq!(dataset["clips"].as_array().unwrap().len(), 3);
    let text = succeeds(&srflow(set, &["data", "clips:set", "--clips"]));
    assert!(text.contains("3 clips: 1 negative, 1 positive, 1 surprise, 1 subjects"), "{text}");
    assert!(text.contains("s01/s01/c01"), "{text}");
}

#[test]
fn the_motion_of_expressions_is_scored_on_a_rendered_set() {
    let arguments = ["eval", "--dataset", "clips:set", "--method", "tvl1", "--expression"];
    let eval =
        |more: &[&str]| crate::srflow().current_dir(SET.path()).args(arguments).args(more).output().unwrap();
    let scores = crate::json(&eval(&["--json"]));
    let of = |method: usize, what: &str| scores["methods"][method]["expression"][what].as_f64().unwrap();
    assert!(of(1, "correlation") > 0.3 && of(1, "correlation") < 1.0, "{}", of(1, "correlation"));
    assert!(of(1, "strength") > 0.1 && of(1, "strength") < 1.5, "{}", of(1, "strength"));
    assert_eq!((of(0, "correlation"), of(0, "strength")), (0.0, 0.0), "zero flow shows none");
    assert!(of(1, "true_rms") > 0.01);
    assert!(scores["methods"][1]["head"]["epe"].is_number(), "the masks of the set");
    let text = succeeds(&eval(&[]));
    for part in ["clips, 3 pairs, motion of the expression (0.", "correlation ↑", "strength"] {
        assert!(text.contains(part), "{part:?} in {text}");
    }
}

#[test]
fn the_flow_of_expressions_is_scored_on_a_rendered_set() {
    let arguments = ["eval", "--dataset", "clips:set", "--method", "tvl1", "--expression-error"];
    let eval =
        |more: &[&str]| crate::srflow().current_dir(SET.path()).args(arguments).args(more).output().unwrap();
    let scores = crate::json(&eval(&["--json"]));
    let of =
        |method: usize, what: &str| scores["methods"][method]["expression_error"][what].as_f64().unwrap();
    assert!(of(1, "expression_epe") > of(1, "floor_epe"), "TV-L1 is not exact");
    assert!(of(0, "floor_epe") < of(0, "expression_epe"), "the true flow shows the expression");
    assert!((of(1, "ratio") - of(1, "expression_epe") / of(1, "flow_epe")).abs() < 1e-9);
    assert_eq!(scores["methods"][1]["pairs"].as_array().unwrap().len(), 3);
    assert!(scores["methods"][1]["pairs"][2]["expression_error"]["ratio"].is_number());
    let text = succeeds(&eval(&[]));
    for part in
        ["clips, 3 pairs, flow of the expression in the face (0.", "EPE flow ↓", "EPE expression ↓", "ratio"]
    {
        assert!(text.contains(part), "{part:?} in {text}");
    }
    succeeds(&eval(&["--out", "scores-with-parts"]));
    let page = fs::read_to_string(SET.path().join("scores-with-parts/report.html")).unwrap();
    assert!(page.contains("flow of the expression in the face"));
}

#[test]
fn the_published_annotations_are_listed_with_dropped_rows() {
    let Some(dir) = annotations() else { return };
    let folder = tempfile::tempdir().unwrap();
    let sources: Vec<String> =
        ["samm", "casme2", "smic"].iter().map(|kind| format!("{kind}:{}", dir.display())).collect();
    let sources: Vec<&str> = sources.iter().map(String::as_str).collect();
    let report = json(folder.path(), &[&["data", "--labels-only"], &sources[..]].concat());
    assert_eq!((&report["composite"]["total"], &report["subjects"]), (&435.into(), &68.into()));
    assert!(report["datasets"].as_array().unwrap().iter().all(|dataset| dataset["as_published"] == true));
    let text = succeeds(&srflow(folder.path(), &[&["data", "--labels-only"], &sources[..]].concat()));
    for expected in [
        "composite: 435 clips: 245 negative, 109 positive, 81 surprise, 68 subjects",
        "92 negative, 26 positive, 15 surprise, 28 subjects, as published",
        "negative     65 negative, 1 surprise\n",
        "disgust      61 negative, 2 dropped\n",
        "1: the apex is not a frame number\n    04/EP12_01f (disgust)",
    ] {
        assert!(text.contains(expected), "{text}");
    }
    refuses(&srflow(folder.path(), &["data", sources[0]]), 1, &["looked for", "006/006_1_2"]);
}

#[test]
fn missing_frames_stop_unless_allowed() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("a")).unwrap();
    fs::write(folder.path().join("clips.csv"), "clip,subject,onset,apex,offset,class\na,1,1,2,4,positive\n")
        .unwrap();
    for frame in [1, 2, 4] {
        fs::write(folder.path().join(format!("a/{frame}.png")), "").unwrap();
    }
    let expected = ["1 frames of 1 clips", "1/a: 1 frame: 3"];
    refuses(&srflow(folder.path(), &["data", "clips:."]), 1, &expected);
    let text = succeeds(&srflow(folder.path(), &["data", "clips:.", "--allow-missing"]));
    assert!(
        text.contains("missing      1 frames of 1 clips") && text.contains("1 clips: 0 negative, 1 positive"),
        "{text}"
    );
    // An unreadable frame is named.
    refuses(&srflow(folder.path(), &["apex", "clips:.", "--allow-missing"]), 1, &["1.png", "magic"]);
}

#[test]
fn wrong_usage_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mer = |arguments: &[&str]| srflow(folder.path(), arguments);
    refuses(&mer(&["data", "casme4:x"]), 2, &["casme2[-raw|-cropped]"]);
    let error = fails(&mer(&["data", "samm:nowhere"]), 1);
    assert!(error.contains("nowhere: ") && error.matches("os error").count() <= 1, "named once: {error}");
    let other = mer(&["data", "clips:x", "--annotations", "samm:y"]);
    refuses(&other, 1, &["none of the datasets is of the kind `samm`"]);
    refuses(&mer(&["synth", "--out", "x", "--side", "3"]), 2, &["--side 3: expected 64 to 4096"]);
}

#[test]
fn apexes_are_spotted_and_compared() {
    let set = SET.path();
    for (rule, extra) in [("strain", None), ("ratio", Some(["--landmarks", "set/landmarks.csv"]))] {
        let extra = extra.as_ref().map_or(&[][..], |extra| &extra[..]);
        let list = format!("{rule}.csv");
        let arguments = [&["apex", "clips:set", "--rule", rule, "--out", &list], extra].concat();
        let report = json(set, &arguments);
        let errors = &report["errors"]["set"];
        assert_eq!(errors["clips"], 3);
        assert!(errors["mean_absolute_frames"].as_f64().unwrap() < 8.0, "{errors}");
        let listed = fs::read_to_string(set.join(&list)).unwrap();
        let spotted = report["clips"][0]["spotted"].as_u64().unwrap();
        assert!(listed.lines().nth(1).unwrap().contains(&format!(",{spotted},")), "{listed}");
        refuses(&srflow(set, &arguments), 1, &["--force"]);
    }
}

#[test]
fn strain_is_written_as_an_array_and_a_picture() {
    let set = SET.path();
    let clips = json(set, &["data", "clips:set"]);
    let clip = &clips["datasets"][0]["clips"][0];
    let frame =
        |key: &str| format!("set/{}/{:04}.png", clip["clip"].as_str().unwrap(), clip[key].as_u64().unwrap());
    let (onset, apex) = (frame("onset"), frame("apex"));
    let common = ["strain", &onset, &apex, "--force", "-o"];
    let report = json(set, &[&common[..], &["s.npy", "--viz", "s.png", "--features", "f.npy"]].concat());
    assert!(report["max_strain"].as_f64().unwrap() > 0.0);
    let (strain, features) = (read_npy(&set.join("s.npy")).unwrap(), read_npy(&set.join("f.npy")).unwrap());
    assert_eq!((&strain.shape[..], &features.shape[..]), (&[112, 112][..], &[3, 112, 112][..]));
    assert_eq!(strain.values, features.values[2 * 112 * 112..]);
    assert_eq!(read_image(&set.join("s.png")).unwrap().size(), Size::new(112, 112));

    json(set, &[&common[..], &["o.npy", "--formula", "off-tanet"]].concat());
    assert_ne!(read_npy(&set.join("o.npy")).unwrap().values, strain.values);
    let full = json(set, &[&common[..], &["full.npy", "--size", "full"]].concat());
    assert_eq!((&full["width"], &full["height"]), (&96.into(), &96.into()));
    // A file of the flow gives what the frames give.
    succeeds(
        &crate::srflow().current_dir(set).args(["flow", &onset, &apex, "-o", "flow.flo"]).output().unwrap(),
    );
    let of_flow = json(set, &["strain", "flow.flo", "--force", "-o", "of_flow.npy"]);
    assert_eq!(read_npy(&set.join("of_flow.npy")).unwrap().values, strain.values, "{of_flow}");
    // A crop to a box is the same before the flow is read as before it is estimated elsewhere.
    let boxed =
        json(set, &["strain", "flow.flo", "--face-box", "8,8,80x80", "--size", "full", "-o", "box.npy"]);
    assert_eq!((&boxed["width"], &boxed["height"]), (&80.into(), &80.into()));
    let cropped = json(set, &[&common[..], &["crop.npy", "--face-box", "8,8,80x80"]].concat());
    assert!(cropped["max_strain"].as_f64().unwrap() > 0.0);
    let none = srflow(set, &["strain", "flow.flo", "--resize", "before", "-o", "x.npy"]);
    refuses(&none, 2, &["needs two frames", "flow.flo"]);
    let outside = srflow(set, &["strain", "flow.flo", "--face-box", "90,0,9x9", "-o", "x.npy"]);
    refuses(&outside, 1, &["does not lie in a frame of 96x96"]);
    let other = srflow(set, &["strain", &onset, "s.png", "-o", "x.npy"]);
    refuses(&other, 1, &["give two frames of one size"]);
}
