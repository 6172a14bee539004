//! `srflow view`: what it takes and refuses, and its pages in a browser.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use srflow_core::Size;

use crate::frames::write_pairs;

fn view(arguments: &[&str], folder: &Path) -> Output {
    crate::srflow().arg("view").args(arguments).current_dir(folder).output().unwrap()
}

fn error_of(output: &Output) -> String {
    assert!(!output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_thing_is_found_by_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    write_pairs(&folder.path().join("pairs/test"), 2, Size::new(72, 64), 1.5);
    let output = view(&["folder:pairs", "--split", "test"], folder.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let page = std::fs::read_to_string(folder.path().join("pairs.html")).unwrap();
    assert!(page.contains("id=\"pack-1\"") && !page.contains("id=\"pack-2\""));
    let again = error_of(&view(&["folder:pairs", "--split", "test"], folder.path()));
    assert!(again.contains("pairs.html exists; give --force"), "{again}");

    let scored =
        ["eval", "--dataset", "folder:pairs", "--split", "test", "--method", "tvl1", "--out", "results"];
    let eval = |more: &[&str]| {
        crate::srflow().args(scored).args(more).current_dir(folder.path()).output().unwrap().status.success()
    };
    assert!(eval(&[]));
    let without = error_of(&view(&["results"], folder.path()));
    assert!(without.contains("--save-flow results/flow"), "{without}");
    assert!(eval(&["--save-flow", "results/flow", "--force"]));
    assert!(view(&["results"], folder.path()).status.success());
    let page = std::fs::read_to_string(folder.path().join("results.html")).unwrap();
    assert!(page.contains("<title>results, test split</title>"));

    let flows = view(&["results/flow/tvl1", "--json"], folder.path());
    let json: serde_json::Value = serde_json::from_slice(&flows.stdout).unwrap();
    assert_eq!(json["page"], "tvl1.html");
    let page = std::fs::metadata(folder.path().join("tvl1.html")).unwrap();
    assert_eq!(json["bytes"], page.len());
}

#[test]
fn what_cannot_be_shown_is_said_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    std::fs::write(folder.path().join("notes.txt"), "text").unwrap();
    std::fs::write(folder.path().join("scores.json"), "{}").unwrap();
    std::fs::write(folder.path().join("broken.ply"), "ply\nno").unwrap();
    for (arguments, expected) in [
        (&["nothing"][..], "found no such file or folder"),
        (&["notes.txt"], "found a file of another kind"),
        (&["empty"], "expected the folder of an avatar"),
        (&["."], "scores.json: expected what `srflow eval --out` writes"),
        (&["broken.ply"], "broken.ply"),
        (&["builtin", "--method", "tvl1"], "--method is for datasets"),
        (&["builtin", "-o", "page.png"], "this output is a .html file"),
        (&["builtin", "-o", "a.html", "--serve"], "cannot be used with"),
        (&["srflow:empty"], "dataset.json"),
    ] {
        let error = error_of(&view(arguments, folder.path()));
        assert!(error.contains(expected), "{arguments:?}: {error}");
    }
}

/// Runs `tests/browser` with pytest and playwright, in the Chromium of the system.
#[test]
fn pages_pass_their_tests_in_a_browser() {
    let python = std::env::var("SRFLOW_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let ready = Command::new(&python).args(["-c", "import numpy, pytest, playwright"]).output();
    let Some(chromium) = chromium().filter(|_| ready.is_ok_and(|ready| ready.status.success())) else {
        eprintln!(
            "skipped: chromium: not found, or {python} lacks numpy, pytest or playwright; set SRFLOW_CHROMIUM and SRFLOW_PYTHON"
        );
        return;
    };
    let tests = Command::new(&python)
        .args(["-m", "pytest", "-q", "-p", "no:cacheprovider"])
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/browser"))
        .env("SRFLOW_BINARY", env!("CARGO_BIN_EXE_srflow"))
        .env("SRFLOW_CHROMIUM", chromium)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&tests.stdout);
    assert!(tests.status.success(), "{printed}\n{}", String::from_utf8_lossy(&tests.stderr));
}

fn chromium() -> Option<PathBuf> {
    if let Some(named) = std::env::var_os("SRFLOW_CHROMIUM") {
        return Some(named.into());
    }
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let folders = std::env::var_os("PATH")?;
    let found = std::env::split_paths(&folders).flat_map(|folder| names.map(|name| folder.join(name)));
    found.into_iter().find(|program| program.is_file())
}
