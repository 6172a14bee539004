//! `srflow models` as a user meets it: the list of networks, and what a file of weights is.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::Value;

fn models(arguments: &[&str]) -> Output {
    let mut command = crate::srflow();
    command.arg("models").args(arguments).output().unwrap()
}

fn succeeds(arguments: &[&str]) -> String {
    crate::succeeds(&models(arguments))
}

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeeds(&[arguments, &["--json"]].concat())).unwrap()
}

fn checkpoint(name: &str) -> PathBuf {
    Path::new("../nn/tests/checkpoints").join(name)
}

#[test]
fn the_networks_are_listed() {
    let text = succeeds(&[]);
    for name in ["raft", "raft-small", "gma", "skflow", "skflow-things", "BSD-3-Clause"] {
        assert!(text.contains(name), "{name} in {text}");
    }
    let networks = json(&[]);
    let skflow = networks.as_array().unwrap().iter().find(|network| network["name"] == "skflow").unwrap();
    assert_eq!(skflow["parameters"], 6_273_149);
    assert_eq!(skflow["iterations"]["authors"], 15);
    assert_eq!(skflow["weights"][0]["name"], "skflow-things");
    let url = "https://github.com/hmorimitsu/ptlflow/releases/download/weights1/skflow-things-f84e6538.ckpt";
    assert_eq!(skflow["weights"][0]["url"], url);
}

#[test]
fn a_file_of_weights_is_described() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.safetensors");
    let network = srflow_nets::Architecture::SkFlow.init(&Default::default());
    srflow_nn::save_parameters(&network, &path).unwrap();
    let path = path.to_str().unwrap();
    let text = succeeds(&["inspect", path]);
    assert!(text.contains("mine.safetensors: safetensors"), "{text}");
    assert!(text.contains("they are the parameters of skflow (or of MemFlow"), "{text}");
    let inspected = json(&["inspect", path]);
    assert_eq!(inspected["network"], "skflow");
    assert_eq!(inspected["lookalikes"][0], "MemFlow");
    assert_eq!(inspected["parameters"], 6_273_149);
    assert_eq!(inspected["types"][0], "F32");
    assert!(inspected["missing"].as_array().unwrap().is_empty());
}

#[test]
fn weights_of_no_network_are_described_too() {
    let path = checkpoint("lightning.ckpt");
    let text = succeeds(&["inspect", path.to_str().unwrap()]);
    for said in
        ["PyTorch (zip)", "under state_dict", "network. taken off", "8 tensors", "no network known here"]
    {
        assert!(text.contains(said), "{said} in {text}");
    }
    let inspected = json(&["inspect", path.to_str().unwrap()]);
    assert_eq!(inspected["network"], Value::Null);
    assert_eq!(inspected["container"], "state_dict");
    assert_eq!(inspected["nearest"].as_array().unwrap().len(), 4);
    assert_eq!(inspected["unknown"].as_array().unwrap().len(), 8);
}

#[test]
fn what_is_no_checkpoint_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("skflow-things.ckpt");
    fs::write(&page, "<html>not found</html>").unwrap();
    for (path, said) in
        [(page, "a file that starts with `<html>not found"), ("none.pth".into(), "none.pth: ")]
    {
        let output = models(&["inspect", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(1));
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(error.contains(said), "{error}");
    }
    assert_eq!(models(&["inspect"]).status.code(), Some(2));
}

#[test]
fn exported_weights_are_the_same_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    for architecture in srflow_nets::Architecture::ALL {
        let own = path("own.safetensors");
        srflow_nn::save_parameters(&architecture.init(&Default::default()), own.as_ref()).unwrap();
        let (exported, back) = (path("exported.ckpt"), path("back.safetensors"));
        let text = succeeds(&["export", &own, "-o", &exported, "--force"]);
        assert!(text.contains(&format!("weights of {}", architecture.name())), "{text}");
        assert_eq!(json(&["inspect", &exported])["container"], "state_dict");
        let read = |path: &str| srflow_nn::read_parameters(path.as_ref()).unwrap();
        assert!(read(&exported) == read(&own), "{}", architecture.name());
        succeeds(&["export", &exported, "-o", &back, "--force"]);
        assert!(fs::read(&back).unwrap() == fs::read(&own).unwrap(), "{}", architecture.name());
    }
    let refused = models(&["export", &path("own.safetensors"), "-o", &path("exported.ckpt")]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8(refused.stderr).unwrap().contains("--force"));
    assert_eq!(
        models(&["export", &path("own.safetensors"), "-o", &path("weights.onnx")]).status.code(),
        Some(2)
    );
    let other = checkpoint("zip.pth");
    let other = models(&["export", other.to_str().unwrap(), "-o", &path("other.ckpt")]);
    assert_eq!(other.status.code(), Some(1));
    assert!(String::from_utf8(other.stderr).unwrap().contains("no network known here"));
}
