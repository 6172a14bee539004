//! `srflow mer run` from clips on disk to tables, resumed and refused.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::Value;
use srflow_core::Image;
use srflow_files::write_image_png;

use crate::{fails, json, refuses, succeeds};

/// Two subjects with one clip of each class, a third with one clip: a texture whose halves move according to the class.
fn write_clips(folder: &Path) {
    let mut lines = vec!["clip,subject,onset,apex,offset,class".to_owned()];
    for (subject, classes) in [("anna", 3), ("ben", 3), ("carl", 1)] {
        for (class, name) in ["negative", "positive", "surprise"].into_iter().enumerate().take(classes) {
            let clip = format!("{subject}-{name}");
            fs::create_dir(folder.join(&clip)).unwrap();
            for frame in 1..=3_usize {
                let image = Image::from_fn(48, 40, |x, y| {
                    let moves = if (x < 24) == (class == 0) || class == 2 { frame } else { 0 };
                    let value = ((x * 7) as f32 * 0.1).sin() + ((y + moves) as f32 * 0.6).sin();
                    [(127.0 + 60.0 * value) as u8; 3]
                });
                write_image_png(&folder.join(&clip).join(format!("{frame}.png")), &image).unwrap();
            }
            lines.push(format!("{clip},{subject},1,2,3,{name}"));
        }
    }
    fs::write(folder.join("clips.csv"), lines.join("\n") + "\n").unwrap();
}

/// A folder, and the clips in `faces` there.
fn faces() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let clips = folder.path().join("faces");
    fs::create_dir(&clips).unwrap();
    write_clips(&clips);
    (folder, clips)
}

fn run(clips: &Path, out: &Path, more: &[&str]) -> Output {
    crate::srflow()
        .args(["mer", "run", "--data", &format!("clips:{}", clips.display()), "--out"])
        .arg(out)
        .args(["--method", "farneback", "--classifier", "ststnet", "--epochs", "3", "--record-every", "2"])
        .args(more)
        .output()
        .unwrap()
}

#[test]
fn clips_become_tables_and_a_second_run_gives_the_same_bytes() {
    let (folder, clips) = faces();
    let out = folder.path().join("out");
    let first = succeeds(&run(&clips, &out, &[]));
    assert!(first.contains("faces: 7 clips, 3 subjects; after epoch 2"), "{first}");
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    // Seven clips after epochs 0 and 2.
    assert_eq!(read("predictions.csv").lines().count(), 1 + 7 * 2);
    let report = read("report.html");
    assert!(
        report.contains("always negative") && report.contains("faces carl carl-negative"),
        "clips are shown"
    );
    let results: Value = serde_json::from_str(&read("results.json")).unwrap();
    assert_eq!(results["data"][0]["subjects"], 3);
    assert_eq!(results["outcomes"][0]["folds"][2]["clips"], 1);
    assert_eq!(results["protocol_name"], "srflow");
    assert_eq!((&results["protocol"]["epochs"], &results["job"]["record_every"]), (&3.into(), &2.into()));
    assert_eq!(
        (&results["clips"][0]["apex"], &results["clips"][0]["apex_spotted"]),
        (&2.into(), &false.into())
    );
    let motion = results["clips"][0]["head_motion"]["farneback"]["translation_px"][1].as_f64().unwrap();
    assert!(motion.abs() < 4.0, "{motion}");

    refuses(&run(&clips, &out, &[]), 1, &["--force"]);
    let predictions = read("predictions.csv");
    fs::remove_file(out.join("predictions.csv")).unwrap();
    let again = json(&run(&clips, &out, &["--force", "--threads", "1", "--json"]));
    assert_eq!(again["outcomes"][0]["folds"][0]["resumed"], true);
    assert_eq!(read("predictions.csv"), predictions);
    assert_recomputed(&out);
    // From scratch, with another number of threads.
    let elsewhere = folder.path().join("elsewhere");
    succeeds(&run(&clips, &elsewhere, &["--threads", "3"]));
    assert_eq!(fs::read_to_string(elsewhere.join("predictions.csv")).unwrap(), predictions);
}

#[test]
fn protocols_name_what_they_do() {
    let (folder, clips) = faces();
    let run = |out: &str, more: &[&str]| {
        crate::srflow()
            .args([
                "mer",
                "run",
                "--data",
                &format!("clips:{}", clips.display()),
                "--method",
                "farneback",
                "--out",
            ])
            .arg(folder.path().join(out))
            .args(more)
            .output()
            .unwrap()
    };
    let heading = |out: &str| {
        let text = fs::read_to_string(folder.path().join(out).join("tables.txt")).unwrap();
        text.lines().next().unwrap().to_owned()
    };
    let printed = succeeds(&run("ours", &[]));
    assert_eq!(
        heading("ours"),
        "Protocol srflow: whole frames, resized to 112x112 after the flow, head motion subtracted within the face, literature \
         strain; classifier linear"
    );
    assert!(printed.starts_with(&heading("ours")) && !printed.contains("best epoch"), "{printed}");
    assert!(printed.contains("7 clips, 3 subjects; 95 % intervals over subjects"), "{printed}");
    succeeds(&run("paper", &["--protocol", "paper", "--epochs", "1"]));
    assert_eq!(
        heading("paper"),
        "Protocol paper: whole frames, resized to 112x112 before the flow, head motion kept, literature strain; classifier \
         off-tanet"
    );
    let refused = run("epochs", &["--epochs", "21"]);
    refuses(&refused, 1, &["the linear classifier is trained at once and has no use for --epochs"]);
    assert!(!folder.path().join("epochs").exists(), "before any work");
}

fn tables(arguments: &[&Path]) -> Output {
    crate::srflow().args(["mer", "tables"]).args(arguments).output().unwrap()
}

/// Every table of a finished run can be recomputed from its predictions.
fn assert_recomputed(out: &Path) {
    let read = |folder: &Path, name: &str| fs::read_to_string(folder.join(name)).unwrap();
    let again = out.join("again");
    let predictions = out.join("predictions.csv");
    let printed = succeeds(&tables(&[&predictions, Path::new("--out"), &again]));
    // The first line of a run names its protocol, which predictions do not know.
    let headed = |name: &str, text: &str| format!("{}\n\n{text}", read(out, name).lines().next().unwrap());
    assert_eq!(headed("tables.txt", &printed), read(out, "tables.txt"));
    for name in ["tables.txt", "tables.tex", "tables.md"] {
        assert_eq!(headed(name, &read(&again, name)), read(out, name), "{name}");
    }
    for name in ["tables.csv", "confusions.csv", "comparisons.csv"] {
        assert_eq!(read(&again, name), read(out, name), "{name}");
    }
    // The training loss, last in a line, cannot.
    let without_loss = |line: &str| line.rsplit_once(',').unwrap().0.to_owned();
    let lines = |text: String| text.lines().map(without_loss).collect::<Vec<_>>();
    assert_eq!(lines(read(&again, "folds.csv")), lines(read(out, "folds.csv")));

    let mut found = json(&tables(&[&predictions, Path::new("--json")]));
    let mut results: Value = serde_json::from_str(&read(out, "results.json")).unwrap();
    results["outcomes"][0].as_object_mut().unwrap().remove("folds").unwrap();
    assert_eq!(found["outcomes"].take(), results["outcomes"].take());

    refuses(&tables(&[&predictions, Path::new("--out"), &again]), 1, &["--force"]);
}

#[test]
fn classes_of_ones_own_go_through_to_the_tables() {
    let (folder, clips) = faces();
    let file = folder.path().join("two.toml");
    let toml = "[[class]]\nname = \"pleased, or not\"\nemotions = [\"negative\", \"positive\"]\n\
        [[class]]\nname = \"startled\"\nemotions = [\"surprise\"]\n";
    fs::write(&file, toml).unwrap();
    let out = folder.path().join("out");
    let text = succeeds(&run(&clips, &out, &["--classes", file.to_str().unwrap()]));
    assert!(text.contains("always pleased, or not"), "{text}");
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    let head =
        "method,set,dataset,subject,clip,truth,epoch,predicted,\"score_pleased, or not\",score_startled";
    assert_eq!(read("predictions.csv").lines().next(), Some(head));
    assert_eq!(read("confusions.csv").lines().count(), 3);
    let results: Value = serde_json::from_str(&read("results.json")).unwrap();
    assert_eq!(results["classes"], serde_json::json!(["pleased, or not", "startled"]));
    assert_eq!(results["outcomes"][0]["baseline"]["always"], "pleased, or not");
    assert_eq!(results["outcomes"][0]["last"]["confusion"].as_array().unwrap().len(), 2);
    assert_recomputed(&out);

    let unknown = run(&clips, &folder.path().join("other"), &["--classes", "casme-5"]);
    refuses(&unknown, 1, &["casme-5: expected 3, megc2019, casme2-5"]);
}

#[test]
fn features_of_key_frames_are_those_of_whole_clips() {
    let (folder, clips) = faces();
    let features = |out: &str, more: &[&str]| {
        crate::srflow()
            .args(["mer", "features", "--data", &format!("clips:{}", clips.display()), "--json", "--out"])
            .arg(folder.path().join(out))
            .args(["--method", "farneback", "tvl1"])
            .args(more)
            .output()
            .unwrap()
    };
    let report = json(&features("whole.npz", &[]));
    assert_eq!(report["shape"], serde_json::json!([14, 3, 112, 112]));
    assert_eq!(report["classes"], serde_json::json!(["negative", "positive", "surprise"]));
    refuses(&features("whole.npz", &[]), 1, &["--force"]);
    refuses(&features("features.npy", &[]), 2, &["a .npz file"]);

    // One clip has 7 more frames, all missing except the last.
    let table = fs::read_to_string(clips.join("clips.csv")).unwrap();
    fs::write(
        clips.join("clips.csv"),
        table.replace("anna-negative,anna,1,2,3", "anna-negative,anna,1,2,10"),
    )
    .unwrap();
    fs::rename(clips.join("anna-negative/3.png"), clips.join("anna-negative/10.png")).unwrap();
    refuses(&features("key.npz", &[]), 1, &["--only-key-frames"]);
    succeeds(&features("key.npz", &["--only-key-frames"]));
    // The pictures, and so the features, are unchanged; so is the recipe. The offset has moved.
    let archive = |name: &str| {
        let mut archive = zip::ZipArchive::new(fs::File::open(folder.path().join(name)).unwrap()).unwrap();
        let mut arrays = BTreeMap::new();
        for index in 0..archive.len() {
            let mut array = archive.by_index(index).unwrap();
            let mut bytes = Vec::new();
            array.read_to_end(&mut bytes).unwrap();
            arrays.insert(array.name().unwrap().into_owned(), bytes);
        }
        arrays
    };
    let (mut key, mut whole) = (archive("key.npz"), archive("whole.npz"));
    assert_ne!(key.remove("offset.npy"), whole.remove("offset.npy"));
    assert!(key == whole);
}

#[test]
fn predictions_that_give_no_tables_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("predictions.csv");
    let head =
        "method,set,dataset,subject,clip,truth,epoch,predicted,score_negative,score_positive,score_surprise";
    let line = "tvl1,samm,samm,006,006_1_2,positive,0,negative,1,0.5,0";
    let whole = format!("{head}\n{line}\n");
    for (contents, expected) in [
        (String::new(), "holds no predictions"),
        (whole.replace("truth", "label"), "no column truth"),
        (whole.replace("positive,0", "happy,0"), "line 2: `happy`"),
        (
            format!("{whole}{line}\n"),
            "samm, tvl1: samm subject 006 clip 006_1_2 has 2 predictions at epoch 0",
        ),
    ] {
        fs::write(&path, contents).unwrap();
        refuses(&tables(&[&path]), 1, &["predictions.csv", expected]);
    }
    refuses(&tables(&[&folder.path().join("gone.csv")]), 1, &["gone.csv"]);
}

/// A killed run leaves finished folds, and, if it was writing its results, tables without results.json.
#[test]
fn folds_are_trained_in_parts() {
    let (folder, clips) = faces();
    let [through, parted] = ["through", "parted"].map(|name| folder.path().join(name));
    succeeds(&run(&clips, &through, &[]));
    let part = |shard| json(&run(&clips, &parted, &["--shard", shard, "--json"]));
    // Of three folds.
    assert_eq!([part("1/2")["folds"].clone(), part("2/2")["folds"].clone()], [1, 2]);
    assert!(!parted.join("results.json").exists());
    assert_eq!(fs::read_dir(parted.join("folds")).unwrap().count(), 3);
    let results = json(&run(&clips, &parted, &["--json"]));
    let folds = results["outcomes"][0]["folds"].as_array().unwrap();
    assert!(folds.iter().all(|fold| fold["resumed"] == true), "{folds:?}");
    let predictions = |out: &Path| fs::read(out.join("predictions.csv")).unwrap();
    assert_eq!(predictions(&parted), predictions(&through));
}

#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    let (folder, clips) = faces();
    let out = folder.path().join("out");
    succeeds(&run(&clips, &out, &[]));
    let predictions = fs::read(out.join("predictions.csv")).unwrap();
    let report = fs::read(out.join("report.html")).unwrap();

    for name in ["results.json", "report.html", "predictions.csv"] {
        fs::remove_file(out.join(name)).unwrap();
    }
    let folds = fs::read_dir(out.join("folds")).unwrap().map(|fold| fold.unwrap().path());
    fs::remove_file(folds.min().unwrap()).unwrap();
    let resumed = json(&run(&clips, &out, &["--json"]));
    let folds = resumed["outcomes"][0]["folds"].as_array().unwrap();
    assert_eq!(folds.iter().filter(|fold| fold["resumed"] == true).count(), 2);
    assert_eq!(fs::read(out.join("predictions.csv")).unwrap(), predictions);
    assert_eq!(fs::read(out.join("report.html")).unwrap(), report);

    // Tables of another origin are not overwritten.
    let others = folder.path().join("others");
    fs::create_dir(&others).unwrap();
    fs::write(others.join("tables.txt"), "mine").unwrap();
    refuses(&run(&clips, &others, &[]), 1, &["tables.txt exists"]);
}

#[test]
fn what_cannot_be_learned_is_named() {
    let (folder, clips) = faces();
    let table = fs::read_to_string(clips.join("clips.csv")).unwrap();
    let without = |word: &str| -> String {
        table.lines().filter(|line| !line.contains(word)).map(|line| format!("{line}\n")).collect()
    };
    fs::write(clips.join("clips.csv"), without("ben-surprise")).unwrap();
    let out = folder.path().join("alone");
    let alone = succeeds(&run(&clips, &out, &[]));
    assert!(alone.contains("left to learn from: faces anna (surprise)."), "{alone}");
    let folds = fs::read_to_string(out.join("folds.csv")).unwrap();
    assert!(folds.contains("faces,farneback,faces,carl,1,2,"), "a subject with one clip is a fold: {folds}");

    fs::write(clips.join("clips.csv"), without("surprise")).unwrap();
    let absent = succeeds(&run(&clips, &folder.path().join("absent"), &[]));
    assert!(absent.contains("faces: no clip shows surprise."), "{absent}");
}

#[test]
fn impossible_runs_are_explained() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let clips = folder.path().join("faces");
    fs::create_dir(&clips).unwrap();
    let missing = fails(&run(&clips, &out, &[]), 1);
    assert!(missing.contains("clips.csv") && missing.matches("looked for").count() == 1, "{missing}");
    write_clips(&clips);
    let frame = clips.join("ben-positive/2.png");
    let whole = fs::read(&frame).unwrap();
    fs::write(&frame, &whole[..whole.len() / 2]).unwrap();
    refuses(&run(&clips, &out, &[]), 1, &["faces/ben/ben-positive: ", "2.png"]);
    fs::write(&frame, whole).unwrap();
    let table = fs::read_to_string(clips.join("clips.csv")).unwrap();
    let alone: Vec<&str> =
        table.lines().filter(|line| !line.contains("ben") && !line.contains("carl")).collect();
    fs::write(clips.join("clips.csv"), alone.join("\n")).unwrap();
    refuses(&run(&clips, &out, &[]), 1, &["at least 2 subjects; found 1"]);
    refuses(&run(&clips, &out, &["--batch", "0"]), 1, &["batch size is 0"]);
    refuses(&run(&clips, &out, &["--sets", "composite"]), 1, &["several datasets"]);
}
