//! `srflow mer run` from clips on disk to tables, resumed and refused.

use std::path::Path;
use std::process::{Command, Output};

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
    Command::new(env!("CARGO_BIN_EXE_srflow"))
        .args(["mer", "run", "--data", &format!("clips:{}", clips.display()), "--out"])
        .arg(out)
        .args(["--method", "farneback", "--classifier", "ststnet", "--epochs", "3", "--record-every", "2"])
        .args(more)
        .output()
        .unwrap()
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
    // From nothing, on another number of threads.
    let elsewhere = folder.path().join("elsewhere");
    assert!(run(&clips, &elsewhere, &["--threads", "3"]).status.success());
    assert_eq!(std::fs::read_to_string(elsewhere.join("predictions.csv")).unwrap(), predictions);
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
    write_clips(&clips);
    let table = std::fs::read_to_string(clips.join("clips.csv")).unwrap();
    let alone: Vec<&str> =
        table.lines().filter(|line| !line.contains("ben") && !line.contains("carl")).collect();
    std::fs::write(clips.join("clips.csv"), alone.join("\n")).unwrap();
    let alone = run(&clips, &out, &[]);
    assert!(text(&alone.stderr).contains("at least 2 subjects; found faces anna"), "{}", text(&alone.stderr));
    let wrong = run(&clips, &out, &["--batch", "0"]);
    assert!(text(&wrong.stderr).contains("batch size is 0"), "{}", text(&wrong.stderr));
    let single = run(&clips, &out, &["--sets", "composite"]);
    assert!(text(&single.stderr).contains("several datasets"), "{}", text(&single.stderr));
}
