//! `srflow shapes` from a user's view.

use std::path::Path;
use std::process::Output;

use crate::{json, refuses, succeeds};

fn shapes(folder: &Path, more: &[&str]) -> Output {
    let mut command = crate::srflow();
    command
        .current_dir(folder)
        .args(["shapes", "--out", "made", "--size", "96x64", "--pairs", "3"])
        .args(more);
    command.output().unwrap()
}

#[test]
fn generic_pairs_are_made_continued_and_scored() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let stopped = shapes(folder, &["--stop-after", "1"]);
    assert_eq!(stopped.status.code(), Some(75), "{stopped:?}");
    let report = json(&shapes(folder, &["--json"]));
    assert_eq!(
        (&report["pairs"], &report["made"], &report["is_whole"]),
        (&3.into(), &2.into(), &true.into())
    );
    let text = succeeds(&shapes(folder, &[]));
    assert!(text.contains("0 of 3 pairs made") && text.contains("chairs:made"), "{text}");

    let mut eval = crate::srflow();
    eval.current_dir(folder).args(["eval", "--dataset", "chairs:made", "--split", "train", "--json"]);
    let scores = json(&eval.args(["--method", "farneback"]).output().unwrap());
    assert!(scores.to_string().contains("farneback"), "{scores}");

    let part = ["--seed", "5", "--shard", "1/2", "--force"];
    let text = succeeds(&shapes(folder, &part));
    assert!(text.contains("Part 1/2 is complete"), "{text}");
}

#[test]
fn mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    refuses(&shapes(folder, &["--motion", "3"]), 2, &["expected 2 numbers between commas, found `3`"]);
    refuses(&shapes(folder, &["--motion", "3,1"]), 2, &["--motion 3,1", "the shorter first"]);
    refuses(&shapes(folder, &["--textures", "nowhere"]), 1, &["--textures nowhere", "a folder of images"]);
    std::fs::create_dir(folder.join("empty")).unwrap();
    refuses(&shapes(folder, &["--textures", "empty"]), 2, &["--textures empty", "a folder with images"]);
    std::fs::create_dir(folder.join("made")).unwrap();
    std::fs::write(folder.join("made/notes.txt"), "mine").unwrap();
    refuses(&shapes(folder, &[]), 1, &["made", "not empty", "shapes.json"]);
}
