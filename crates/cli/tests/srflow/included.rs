//! The network whose weights come with srflow: it is the default, and scores what it scored when the weights were committed.

use serde_json::Value;
use srflow_core::Size;
use srflow_files::read_flow;

use crate::frames::write_frames;
use crate::{json, refuses, srflow, succeeds};

/// End-point error in pixels over all pixels and inside the head, of two heads that the network was not trained on.
const SCORES: [(&str, f64); 2] = [("whole", 0.052_915), ("head", 0.116_660)];

#[test]
fn the_committed_weights_give_the_committed_scores() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| srflow().current_dir(folder.path()).args(arguments).output().unwrap();
    let render = "render --out set --look 1 --preset wild --scenes 2 --frames 2 --size 275x401 --seed 9100 --splits 0,0,1";
    succeeds(&run(&render.split(' ').collect::<Vec<_>>()));
    let scores = json(&run(&["eval", "--dataset", "srflow:set", "--json"]));
    let method = &scores["methods"][1];
    assert_eq!(method["name"], "srflow", "the default");
    for (region, expected) in SCORES {
        let found = method[region]["epe"].as_f64().unwrap();
        assert!(
            (found / expected - 1.0).abs() < 1e-3,
            "{region}: {found} px, and {expected} px at the commit"
        );
    }
    assert_eq!(scores["made_by"][0]["weights"], "included");
    assert!(scores["made_by"][0]["sha256"].as_str().is_some_and(|digest| digest.len() == 64));
}

#[test]
fn without_a_method_flow_is_that_of_srflow() {
    let folder = tempfile::tempdir().unwrap();
    write_frames(folder.path(), 0..2, Size::new(96, 64));
    let run = |more: &[&str]| {
        let arguments = ["flow", "0.png", "1.png", "-o"];
        srflow().current_dir(folder.path()).args(arguments).args(more).output().unwrap()
    };
    succeeds(&run(&["default.flo"]));
    succeeds(&run(&["named.flo", "--method", "srflow"]));
    let export = ["models", "export", "srflow", "-o", "own.safetensors"];
    let exported: Value =
        json(&srflow().current_dir(folder.path()).args(export).arg("--json").output().unwrap());
    assert_eq!(exported["network"], "srflow", "{exported}");
    succeeds(&run(&["exported.flo", "--method", "srflow=own.safetensors"]));
    let read = |name: &str| read_flow(&folder.path().join(name)).unwrap();
    assert!(read("default.flo") == read("named.flo") && read("default.flo") == read("exported.flo"));
    succeeds(&run(&["refined.flo", "--refine"]));
    assert!(read("refined.flo") != read("default.flo"));
    refuses(&run(&["other.flo", "--refine", "--warps", "0"]), 1, &["warps", "between 1 and 10000"]);
}
