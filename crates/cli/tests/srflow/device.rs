//! `srflow device`, on the CPU; docs/guides/gpu.md has the tests of others.

use std::process::Output;

use crate::{json, refuses, srflow};

fn device(arguments: &[&str]) -> Output {
    srflow().arg("device").args(arguments).output().unwrap()
}

#[test]
fn the_cpu_is_listed_first_with_what_it_multiplies() {
    let devices = json(&device(&["--json"]));
    assert_eq!(devices[0]["device"], "cpu");
    assert_eq!(devices[0]["precisions"], serde_json::json!(["f32", "bf16"]));
}

#[test]
fn a_network_and_the_rasterizer_are_timed_and_do_not_differ_from_themselves() {
    let times = ["--repeats", "2", "--against-cpu", "--json"];
    let network = ["network", "srflow", "--size", "128x96", "--iters", "1"];
    let network = json(&device(&[&network[..], &times].concat()));
    assert_eq!((&network["parameters"], &network["precision"]), (&"included".into(), &"f32".into()));
    assert_eq!(network["times"]["seconds"].as_array().unwrap().len(), 2);
    assert_eq!(network["against_cpu"]["max_px"], 0.0);
    assert!(network["against_cpu"]["mean_length_px"].as_f64().unwrap() > 0.0);

    let rasterizer = json(&device(&[&["rasterizer", "--size", "110x160"][..], &times].concat()));
    assert!(rasterizer["visible"].as_u64().unwrap() > 1000);
    assert_eq!(rasterizer["against_cpu"]["max_levels"], 0);
    assert_eq!(rasterizer["against_cpu"]["flow"]["max_px"], 0.0);
}

#[test]
fn what_cannot_be_timed_says_what_can() {
    refuses(&device(&["network", "cnn"]), 2, &["unknown network", "raft"]);
    refuses(&device(&["network", "raft", "--device", "gpu"]), 2, &["--device", "cpu, cuda, vulkan"]);
    refuses(&device(&["network", "raft", "--precision", "f16"]), 2, &["--device cpu", "it has f32, bf16"]);
    refuses(&device(&["rasterizer", "--size", "large"]), 2, &["--size", "WIDTHxHEIGHT"]);
    refuses(&device(&["rasterizer", "--repeats", "0"]), 2, &["--repeats"]);
}
