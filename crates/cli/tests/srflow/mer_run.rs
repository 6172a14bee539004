//! `srflow mer run` from clips on disk to tables, resumed and refused.

use std::path::Path;
use std::process::Output;

use srflow_field::{Image, write_image_png};

/// Two subjects with a clip of each class, a third with one clip: a texture whose halves move with the class.
fn write_clips(folder: &Path) {
    let mut lines = vec!["clip,subject,onset,apex,offset,class".to_owned()];
    for (subject, classes) in [("anna", 3), ("ben", 3), ("carl", 1)] {
        for (class, name) in ["negative", "positive", "surprise"].into_iter().enumerate().take(classes) {
            let clip = format!("{subject}-{name}");
            std::fs::create_dir(folder.join(&clip)).unwrap();
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
    std::fs::write(folder.join("clips.csv"), lines.join("\n") + "\n").unwrap();
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

/// Standard output, or what went wrong.
fn text_of(output: &Output) -> &str {
    text(if output.status.success() { &output.stdout } else { &output.stderr })
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

#[test]
fn clips_become_tables_and_a_second_run_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let clips = folder.path().join("faces");
    std::fs::create_dir(&clips).unwrap();
    write_clips(&clips);
    let out = folder.path().join("out");
    let first = run(&clips, &out, &[]);
    assert!(first.status.success(), "{}", text(&first.stderr));
    assert!(
        text(&first.stdout).contains("faces: 7 clips, 3 subjects; after epoch 2"),
        "{}",
        text(&first.stdout)
    );
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    // Seven clips after epochs 0 and 2.
    assert_eq!(read("predictions.csv").lines().count(), 1 + 7 * 2);
    let report = read("report.html");
    assert!(
        report.contains("always negative") && report.contains("faces carl carl-negative"),
        "clips are shown"
    );
    let results: serde_json::Value = serde_json::from_str(&read("results.json")).unwrap();
    assert_eq!(results["data"][0]["subjects"], 3);
    assert_eq!(results["outcomes"][0]["folds"][2]["clips"], 1);

    let refused = run(&clips, &out, &[]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stderr).contains("--force"), "{}", text(&refused.stderr));
    let predictions = read("predictions.csv");
    std::fs::remove_file(out.join("predictions.csv")).unwrap();
    let again = run(&clips, &out, &["--force", "--threads", "1", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&again.stdout).unwrap();
    assert_eq!(json["outcomes"][0]["folds"][0]["resumed"], true);
    assert_eq!(read("predictions.csv"), predictions);
    assert_recomputed(&out);
    // From nothing, on another number of threads.
    let elsewhere = folder.path().join("elsewhere");
    assert!(run(&clips, &elsewhere, &["--threads", "3"]).status.success());
    assert_eq!(std::fs::read_to_string(elsewhere.join("predictions.csv")).unwrap(), predictions);
}

fn tables(arguments: &[&Path]) -> Output {
    crate::srflow().args(["mer", "tables"]).args(arguments).output().unwrap()
}

/// Every table of a finished run follows from its predictions.
fn assert_recomputed(out: &Path) {
    let read = |folder: &Path, name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
    let again = out.join("again");
    let predictions = out.join("predictions.csv");
    let output = tables(&[&predictions, Path::new("--out"), &again]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(text(&output.stdout), read(out, "tables.txt"));
    for name in ["tables.txt", "tables.csv", "tables.tex", "tables.md", "confusions.csv"] {
        assert_eq!(read(&again, name), read(out, name), "{name}");
    }
    // The training loss, which stands last in a line, follows from no prediction.
    let without_loss = |line: &str| line.rsplit_once(',').unwrap().0.to_owned();
    let lines = |text: String| text.lines().map(without_loss).collect::<Vec<_>>();
    assert_eq!(lines(read(&again, "folds.csv")), lines(read(out, "folds.csv")));

    let json = tables(&[&predictions, Path::new("--json")]);
    let mut found: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
    let mut results: serde_json::Value = serde_json::from_str(&read(out, "results.json")).unwrap();
    results["outcomes"][0].as_object_mut().unwrap().remove("folds").unwrap();
    assert_eq!(found["outcomes"].take(), results["outcomes"].take());

    let refused = tables(&[&predictions, Path::new("--out"), &again]);
    assert!(text(&refused.stderr).contains("--force"), "{}", text(&refused.stderr));
}

#[test]
fn classes_of_ones_own_go_through_to_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let clips = folder.path().join("faces");
    std::fs::create_dir(&clips).unwrap();
    write_clips(&clips);
    let file = folder.path().join("two.toml");
    let toml = "[[class]]\nname = \"pleased, or not\"\nemotions = [\"negative\", \"positive\"]\n\
        [[class]]\nname = \"startled\"\nemotions = [\"surprise\"]\n";
    std::fs::write(&file, toml).unwrap();
    let out = folder.path().join("out");
    let output = run(&clips, &out, &["--classes", file.to_str().unwrap()]);
    assert!(output.status.success(), "{}", text_of(&output));
    assert!(text_of(&output).contains("always pleased, or not"), "{}", text_of(&output));
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let head =
        "method,set,dataset,subject,clip,truth,epoch,predicted,\"score_pleased, or not\",score_startled";
    assert_eq!(read("predictions.csv").lines().next(), Some(head));
    assert_eq!(read("confusions.csv").lines().count(), 3);
    let results: serde_json::Value = serde_json::from_str(&read("results.json")).unwrap();
    assert_eq!(results["classes"], serde_json::json!(["pleased, or not", "startled"]));
    assert_eq!(results["outcomes"][0]["baseline"]["always"], "pleased, or not");
    assert_eq!(results["outcomes"][0]["last"]["confusion"].as_array().unwrap().len(), 2);
    assert_recomputed(&out);

    let unknown = run(&clips, &folder.path().join("other"), &["--classes", "casme-5"]);
    assert!(text(&unknown.stderr).contains("casme-5: expected 3, casme2-5"), "{}", text(&unknown.stderr));
}

#[test]
fn features_of_key_frames_are_those_of_whole_clips() {
    let folder = tempfile::tempdir().unwrap();
    let clips = folder.path().join("faces");
    std::fs::create_dir(&clips).unwrap();
    write_clips(&clips);
    let features = |out: &str, more: &[&str]| {
        crate::srflow()
            .args(["mer", "features", "--data", &format!("clips:{}", clips.display()), "--json", "--out"])
            .arg(folder.path().join(out))
            .args(["--method", "farneback", "tvl1"])
            .args(more)
            .output()
            .unwrap()
    };
    let whole = features("whole.npz", &[]);
    let report: serde_json::Value = serde_json::from_slice(&whole.stdout).unwrap();
    assert_eq!(report["shape"], serde_json::json!([14, 3, 112, 112]));
    assert_eq!(report["classes"], serde_json::json!(["negative", "positive", "surprise"]));
    assert!(text(&features("whole.npz", &[]).stderr).contains("--force"));
    assert!(text(&features("features.npy", &[]).stderr).contains("ends in .npz"));

    // One clip goes on for 7 frames of which none is there but its last.
    let table = std::fs::read_to_string(clips.join("clips.csv")).unwrap();
    std::fs::write(
        clips.join("clips.csv"),
        table.replace("anna-negative,anna,1,2,3", "anna-negative,anna,1,2,10"),
    )
    .unwrap();
    std::fs::rename(clips.join("anna-negative/3.png"), clips.join("anna-negative/10.png")).unwrap();
    let refused = features("key.npz", &[]);
    assert!(text(&refused.stderr).contains("--only-key-frames"), "{}", text(&refused.stderr));
    let key = features("key.npz", &["--only-key-frames"]);
    assert!(key.status.success(), "{}", text(&key.stderr));
    // Pictures, and with them features, are the same; of the recipe nothing has changed either.
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert!(bytes("key.npz") == bytes("whole.npz"));
}

#[test]
fn predictions_that_give_no_tables_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("predictions.csv");
    let head =
        "method,set,dataset,subject,clip,truth,epoch,predicted,score_negative,score_positive,score_surprise";
    let line = "tvl1,samm,samm,006,006_1_2,positive,0,negative,1,0.5,0";
    let whole = format!("{head}\n{line}\n");
    let error = |contents: &str| {
        std::fs::write(&path, contents).unwrap();
        let output = tables(&[&path]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stdout));
        assert!(output.stdout.is_empty());
        text(&output.stderr).to_owned()
    };
    for (contents, expected) in [
        (String::new(), "holds no predictions"),
        (whole.replace("truth", "label"), "no column truth"),
        (whole.replace("positive,0", "happy,0"), "line 2: `happy`"),
        (
            format!("{whole}{line}\n"),
            "samm, tvl1: samm subject 006 clip 006_1_2 has 2 predictions at epoch 0",
        ),
    ] {
        let error = error(&contents);
        assert!(error.contains("predictions.csv") && error.contains(expected), "{error}");
    }
    let gone = tables(&[&folder.path().join("gone.csv")]);
    assert!(text(&gone.stderr).contains("gone.csv"), "{}", text(&gone.stderr));
}

/// A run that is killed leaves finished folds, and tables but no results.json when it was writing its results.
#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let clips = folder.path().join("faces");
    std::fs::create_dir(&clips).unwrap();
    write_clips(&clips);
    let out = folder.path().join("out");
    assert!(run(&clips, &out, &[]).status.success());
    let predictions = std::fs::read(out.join("predictions.csv")).unwrap();
    let report = std::fs::read(out.join("report.html")).unwrap();

    for name in ["results.json", "report.html", "predictions.csv"] {
        std::fs::remove_file(out.join(name)).unwrap();
    }
    let folds = std::fs::read_dir(out.join("folds")).unwrap().map(|fold| fold.unwrap().path());
    std::fs::remove_file(folds.min().unwrap()).unwrap();
    let resumed = run(&clips, &out, &["--json"]);
    assert!(resumed.status.success(), "{}", text(&resumed.stderr));
    let json: serde_json::Value = serde_json::from_slice(&resumed.stdout).unwrap();
    let folds = json["outcomes"][0]["folds"].as_array().unwrap();
    assert_eq!(folds.iter().filter(|fold| fold["resumed"] == true).count(), 2);
    assert_eq!(std::fs::read(out.join("predictions.csv")).unwrap(), predictions);
    assert_eq!(std::fs::read(out.join("report.html")).unwrap(), report);

    // Tables of no run that was begun here are somebody's own.
    let others = folder.path().join("others");
    std::fs::create_dir(&others).unwrap();
    std::fs::write(others.join("tables.txt"), "mine").unwrap();
    let refused = run(&clips, &others, &[]);
    assert!(text(&refused.stderr).contains("tables.txt exists"), "{}", text(&refused.stderr));
}

#[test]
fn what_cannot_be_learned_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let clips = folder.path().join("faces");
    std::fs::create_dir(&clips).unwrap();
    write_clips(&clips);
    let table = std::fs::read_to_string(clips.join("clips.csv")).unwrap();
    let without = |word: &str| -> String {
        table.lines().filter(|line| !line.contains(word)).map(|line| format!("{line}\n")).collect()
    };
    std::fs::write(clips.join("clips.csv"), without("ben-surprise")).unwrap();
    let out = folder.path().join("alone");
    let alone = run(&clips, &out, &[]);
    assert!(
        text(&alone.stdout).contains("left to learn from: faces anna (surprise)."),
        "{}",
        text(&alone.stdout)
    );
    let folds = std::fs::read_to_string(out.join("folds.csv")).unwrap();
    assert!(folds.contains("faces,farneback,faces,carl,1,2,"), "a subject with one clip is a fold: {folds}");

    std::fs::write(clips.join("clips.csv"), without("surprise")).unwrap();
    let absent = run(&clips, &folder.path().join("absent"), &[]);
    assert!(text(&absent.stdout).contains("faces: no clip shows surprise."), "{}", text(&absent.stdout));
}

#[test]
fn what_cannot_be_run_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let clips = folder.path().join("faces");
    std::fs::create_dir(&clips).unwrap();
    let missing = run(&clips, &out, &[]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(text(&missing.stderr).contains("clips.csv"), "{}", text(&missing.stderr));
    assert_eq!(text(&missing.stderr).matches("looked for").count(), 1, "{}", text(&missing.stderr));
    write_clips(&clips);
    let frame = clips.join("ben-positive/2.png");
    let whole = std::fs::read(&frame).unwrap();
    std::fs::write(&frame, &whole[..whole.len() / 2]).unwrap();
    let broken = run(&clips, &out, &[]);
    let error = text(&broken.stderr);
    assert!(error.contains("faces/ben/ben-positive: ") && error.contains("2.png"), "{error}");
    std::fs::write(&frame, whole).unwrap();
    let table = std::fs::read_to_string(clips.join("clips.csv")).unwrap();
    let alone: Vec<&str> =
        table.lines().filter(|line| !line.contains("ben") && !line.contains("carl")).collect();
    std::fs::write(clips.join("clips.csv"), alone.join("\n")).unwrap();
    let alone = run(&clips, &out, &[]);
    assert!(text(&alone.stderr).contains("at least 2 subjects; found 1"), "{}", text(&alone.stderr));
    let wrong = run(&clips, &out, &["--batch", "0"]);
    assert!(text(&wrong.stderr).contains("batch size is 0"), "{}", text(&wrong.stderr));
    let single = run(&clips, &out, &["--sets", "composite"]);
    assert!(text(&single.stderr).contains("several datasets"), "{}", text(&single.stderr));
}
