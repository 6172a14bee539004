//! The rule on directions of ARCHITECTURE.md: a crate depends only on crates above it in the pipeline.

use std::process::Command;

use serde_json::Value;

/// The pipeline, first to last, as ARCHITECTURE.md lists it.
const PIPELINE: [&str; 23] = [
    "srflow-no-clap",
    "srflow-simd",
    "srflow-core",
    "srflow-files",
    "srflow-splat",
    "srflow-avatar",
    "srflow-fetch",
    "srflow-pack",
    "srflow-data",
    "srflow-render",
    "srflow-classical",
    "srflow-eval",
    "srflow-ops",
    "srflow-face",
    "srflow-nn",
    "srflow-nets",
    "srflow-train",
    "srflow-mer",
    "srflow-figure",
    "srflow-view",
    "srflow",
    "srflow-cli",
    "srflow-python",
];

fn cargo(arguments: &[&str]) -> Vec<u8> {
    let program = std::env::var_os("CARGO").expect("cargo runs the tests");
    let output = Command::new(program).args(arguments).current_dir("../..").output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// `cargo metadata` for the platform that the tests run on.
pub(crate) fn metadata(more: &[&str]) -> Value {
    let version = String::from_utf8(cargo(&["-vV"])).expect("text");
    let host = version.lines().find_map(|line| line.strip_prefix("host: ")).expect("cargo names its host");
    let arguments = [&["metadata", "--format-version", "1", "--filter-platform", host], more].concat();
    serde_json::from_slice(&cargo(&arguments)).expect("cargo metadata is JSON")
}

#[test]
fn crates_depend_only_on_crates_above_them() {
    let metadata = metadata(&["--no-deps", "--offline"]);
    let packages = metadata["packages"].as_array().expect("packages");
    let rank = |name: &str| PIPELINE.iter().position(|&crate_name| crate_name == name);
    assert_eq!(packages.len(), PIPELINE.len(), "PIPELINE and ARCHITECTURE.md list every crate");
    for package in packages {
        let name = package["name"].as_str().expect("name");
        let own = rank(name).unwrap_or_else(|| panic!("{name} is missing in PIPELINE and ARCHITECTURE.md"));
        for dependency in package["dependencies"].as_array().expect("dependencies") {
            let dependency = dependency["name"].as_str().expect("name");
            // Tests of a crate may turn on one of its features.
            if let Some(other) = rank(dependency).filter(|_| dependency != name) {
                assert!(other < own, "{name} must not depend on {dependency}, which comes after it");
            }
        }
    }
}

/// Evaluating and training must not compile the renderer.
#[test]
fn readers_do_not_depend_on_the_renderer() {
    let metadata = metadata(&["--no-deps", "--offline"]);
    let packages = metadata["packages"].as_array().expect("packages");
    let dependencies_of = |name: &str| -> Vec<&str> {
        let package =
            packages.iter().find(|package| package["name"] == name).expect("a crate of the workspace");
        let dependencies = package["dependencies"].as_array().expect("dependencies");
        let normal = dependencies.iter().filter(|dependency| dependency["kind"].is_null());
        normal
            .filter_map(|dependency| dependency["name"].as_str())
            .filter(|name| PIPELINE.contains(name))
            .collect()
    };
    for name in ["srflow-data", "srflow-eval", "srflow-nets", "srflow-train", "srflow-mer"] {
        let mut reached = vec![name];
        let mut next = 0;
        while let Some(&at) = reached.get(next) {
            next += 1;
            for dependency in dependencies_of(at) {
                if !reached.contains(&dependency) {
                    reached.push(dependency);
                }
            }
        }
        for renderer in ["srflow-splat", "srflow-avatar", "srflow-render"] {
            assert!(
                !reached.contains(&renderer),
                "{name} must not depend on {renderer}; it reaches {reached:?}"
            );
        }
    }
}

#[test]
fn the_architecture_page_lists_every_crate_in_order() {
    let page = std::fs::read_to_string("../../ARCHITECTURE.md").expect("ARCHITECTURE.md");
    let rows: Vec<&str> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| `srflow"))
        .filter_map(|rest| rest.split('`').next())
        .collect();
    let listed: Vec<String> = rows.iter().map(|rest| format!("srflow{rest}")).collect();
    assert_eq!(listed, PIPELINE);
}
