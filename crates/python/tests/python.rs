//! Runs the tests of the Python package, with the library that cargo has built for this test.
//!
//! They need a Python of 3.10 or later with numpy and pytest: `python3`, or the one that `SRFLOW_PYTHON` names.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::{Path, PathBuf};
use std::process::Command;

#[test]
fn the_package_passes_its_tests() {
    let python = std::env::var("SRFLOW_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let ready = Command::new(&python).args(["-c", "import numpy, pytest"]).output();
    if !ready.is_ok_and(|ready| ready.status.success()) {
        eprintln!("skipped: python: {python} lacks numpy or pytest; set SRFLOW_PYTHON");
        return;
    }
    let package = tempfile::tempdir().unwrap();
    let folder = package.path().join("srflow");
    std::fs::create_dir(&folder).unwrap();
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    for file in std::fs::read_dir(here.join("srflow")).unwrap().map(|entry| entry.unwrap().path()) {
        if file.is_file() {
            std::fs::copy(&file, folder.join(file.file_name().unwrap())).unwrap();
        }
    }
    let extension = if cfg!(windows) { "_srflow.pyd" } else { "_srflow.abi3.so" };
    std::fs::copy(library(), folder.join(extension)).unwrap();
    let tests = Command::new(&python)
        .args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"])
        .arg(here.join("tests"))
        .env("PYTHONPATH", package.path())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .current_dir(package.path())
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&tests.stdout);
    assert!(tests.status.success(), "{printed}\n{}", String::from_utf8_lossy(&tests.stderr));
    // "SKIPPED [1] test_flow.py:61: pytorch: not installed"
    for line in printed.lines().filter(|line| line.starts_with("SKIPPED ")) {
        eprintln!("skipped: {}", line.split_once(": ").map_or(line, |(_, reason)| reason));
    }
}

/// The newest beside this test, or one folder up; cargo may add a hash to its name.
fn library() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let files = test.ancestors().skip(1).take(2).flat_map(|folder| std::fs::read_dir(folder).unwrap());
    let is_library = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        name.starts_with(&format!("{DLL_PREFIX}_srflow")) && name.ends_with(DLL_SUFFIX)
    };
    files
        .map(|file| file.unwrap().path())
        .filter(is_library)
        .max_by_key(|path| path.metadata().and_then(|metadata| metadata.modified()).ok())
        .unwrap_or_else(|| panic!("the library _srflow is not near {}", test.display()))
}
