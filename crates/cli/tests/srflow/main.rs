//! The binary from a user's view, one module per command, in a single test program so that the libraries are linked once.

use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;

mod ablation;
mod architecture;
mod avatar;
mod avatar_eval;
mod avatar_files;
mod avatar_from_video;
mod avatar_train;
mod capture;
mod clusters;
mod demo;
mod device;
mod eval;
mod face;
mod figure;
mod fit;
mod flow;
mod flow_networks;
mod frames;
mod hostile;
mod import;
mod included;
mod licences;
mod mer_data;
mod mer_predict;
mod mer_run;
mod metrics_and_convert;
mod models;
mod pack;
mod python_jobs;
mod ranks;
mod rasterize;
// The help lists the devices of a build.
#[cfg(not(any(feature = "cuda", feature = "vulkan")))]
mod reference;
mod render_check;
mod scans;
mod shapes;
mod splats;
mod spotting;
mod train;
mod tree;
mod videos;
mod view;
mod words;

/// The program under test. Read when the tests run: a path fixed at build time would break if the checkout moves.
fn binary() -> PathBuf {
    std::env::var_os("CARGO_BIN_EXE_srflow").expect("cargo runs the tests").into()
}

fn srflow() -> Command {
    Command::new(binary())
}

/// Standard output of a run that succeeds and prints nothing to standard error, where progress is for terminals only.
#[track_caller]
fn succeeds(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(output.stderr.is_empty(), "{output:?}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Standard error of a run that succeeds and has something to note.
#[track_caller]
fn notes(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Standard error of a run that fails with this exit code and prints no result; with `--json`, it prints the error instead.
#[track_caller]
fn fails(output: &Output, code: i32) -> String {
    assert_eq!(output.status.code(), Some(code), "{output:?}");
    let error = String::from_utf8(output.stderr.clone()).unwrap();
    assert!(error.starts_with("error: ") && !error.contains("panicked"), "{error}");
    if !output.stdout.is_empty() {
        let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(printed.as_object().is_some_and(|keys| keys.len() == 1), "{output:?}");
        assert!(error.contains(printed["error"].as_str().unwrap()), "{output:?}");
    }
    error
}

/// What a run with `--json` that succeeds prints.
#[track_caller]
fn json(output: &Output) -> Value {
    serde_json::from_str(&succeeds(output)).unwrap()
}

/// A run that fails with this exit code and says each of these parts.
#[track_caller]
fn refuses(output: &Output, code: i32, parts: &[&str]) {
    let error = fails(output, code);
    for part in parts {
        assert!(error.contains(part), "`{part}` is not in: {error}");
    }
}
