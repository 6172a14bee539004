//! `srflow models`: the list of networks, and inspecting files of weights.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::Value;

use crate::refuses;

fn models(arguments: &[&str]) -> Output {
    let mut command = crate::srflow();
    command.arg("models").args(arguments).output().unwrap()
}

fn succeeds(arguments: &[&str]) -> String {
    crate::succeeds(&models(arguments))
}

fn json(arguments: &[&str]) -> Value {
    crate::json(&models(&[arguments, &["--json"]].concat()))
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
    srflow_nets::save_network(&network, srflow_nn::StoredAs::F32, &path).unwrap();
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
        ["PyTorch (zip)", "under state_dict", "prefix network. removed", "8 tensors", "no network of srflow"]
    {
        assert!(text.contains(said), "{said} in {text}");
    }
    let inspected = json(&["inspect", path.to_str().unwrap()]);
    assert_eq!(inspected["network"], Value::Null);
    assert_eq!(inspected["container"], "state_dict");
    assert_eq!(inspected["nearest"].as_array().unwrap().len(), srflow_nets::Architecture::ALL.len());
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
        refuses(&models(&["inspect", path.to_str().unwrap()]), 1, &[said]);
    }
    assert_eq!(models(&["inspect"]).status.code(), Some(2));
}

#[test]
fn exported_weights_are_the_same_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    // The largest would fill gigabytes with more of the same layers.
    let networks = srflow_nets::Architecture::ALL.into_iter();
    for architecture in networks.filter(|network| network.facts().parameters < 50_000_000) {
        // Where several networks have the same parameters, a file's name says whose they are.
        let own = path(&format!("{}.safetensors", architecture.name()));
        srflow_nets::save_network(
            &architecture.init(&Default::default()),
            srflow_nn::StoredAs::F32,
            own.as_ref(),
        )
        .unwrap();
        let exported = path(&format!("{}.ckpt", architecture.name()));
        let back = path("back.safetensors");
        let text = succeeds(&["export", &own, "-o", &exported, "--force"]);
        assert!(text.contains("weights of ") && text.contains(architecture.name()), "{text}");
        assert_eq!(json(&["inspect", &exported])["container"], "state_dict");
        let read = |path: &str| srflow_nn::read_parameters(path.as_ref()).unwrap();
        assert!(read(&exported) == read(&own), "{}", architecture.name());
        succeeds(&["export", &exported, "-o", &back, "--force"]);
        assert!(read(&back) == read(&own), "{}", architecture.name());
    }
    let export = |weights: &str, to: &str| models(&["export", weights, "-o", &path(to)]);
    refuses(&export(&path("raft.safetensors"), "raft.ckpt"), 1, &["--force"]);
    refuses(&export(&path("raft.safetensors"), "weights.h5"), 2, &["weights.h5", ".onnx"]);
    let other = checkpoint("zip.pth");
    refuses(&export(other.to_str().unwrap(), "other.ckpt"), 1, &["no network of srflow"]);
}

/// `crates/nets/tests/onnx.rs` runs the files.
#[test]
fn networks_are_exported_as_onnx() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let weights = |architecture: srflow_nets::Architecture| {
        let file = path(&format!("{}.safetensors", architecture.name()));
        let network = architecture.init(&Default::default());
        srflow_nets::save_network(&network, srflow_nn::StoredAs::F32, file.as_ref()).unwrap();
        file
    };
    let own = path("own.onnx");
    assert!(
        succeeds(&["export", "srflow", "-o", &own])
            .contains("srflow with 2 iterations, for frames of any size")
    );
    let first = fs::read(&own).unwrap();
    refuses(&models(&["export", "srflow", "-o", &own]), 1, &["own.onnx", "--force"]);
    succeeds(&["export", "srflow", "-o", &own, "--force"]);
    assert!(fs::read(&own).unwrap() == first, "the same bytes each time");
    let raft = weights(srflow_nets::Architecture::RaftSmall);
    let fixed = path("fixed.onnx");
    let exported = json(&["export", &raft, "-o", &fixed, "--iters", "3", "--size", "150x133"]);
    assert_eq!(exported["network"], "raft-small");
    assert_eq!((&exported["iterations"], &exported["size"]), (&3.into(), &serde_json::json!([150, 133])));

    let refused = |weights: &str, more: &[&str], code: i32, words: &[&str]| {
        refuses(&models(&[&["export", weights], more].concat()), code, words);
    };
    let gma = weights(srflow_nets::Architecture::Gma);
    let out = path("no.onnx");
    refused(&gma, &["-o", &out], 2, &["no.onnx", "gma cannot", "srflow, raft, raft-small and skflow"]);
    refused("raft-nothing", &["-o", &out], 1, &["raft-nothing"]);
    refused("nonet", &["-o", &out], 1, &["nonet"]);
    refused(&raft, &["-o", &out, "--half"], 2, &["--half", ".safetensors", "no.onnx"]);
    refused(&raft, &["-o", &out, "--size", "640"], 2, &["--size", "WIDTHxHEIGHT"]);
    refused(&raft, &["-o", &out, "--size", "640x0"], 2, &["--size", "WIDTHxHEIGHT"]);
    refused(&raft, &["-o", &out, "--size", "9000000x64"], 2, &["9000000x64", "too large", "65536"]);
    refused(&raft, &["-o", &out, "--iters", "0"], 2, &["--iters"]);
    refused(&raft, &["-o", &path("raft.ckpt"), "--iters", "3"], 2, &["--iters", ".onnx", "raft.ckpt"]);
    refused(&raft, &["-o", &path("no.safetensors"), "--size", "64x64"], 2, &["--size", ".onnx"]);
    refused(&raft, &["-o", &path("none/no.onnx")], 1, &["no.onnx"]);
    assert!(!Path::new(&out).exists());
}

/// The lists of networks in the documents. `SRFLOW_WRITE_DOCS=1` updates them.
#[test]
fn the_documents_list_the_networks() {
    let all = srflow_nets::Architecture::ALL.map(srflow_nets::Architecture::facts);
    let mut networks = String::from(
        "| name | paper | parameters | padding | iterations: default, authors, training | authors' code and weights | licence |\n|---|---|---|---|---|---|---|\n",
    );
    let mut weights = String::new();
    for facts in all {
        assert!(facts.trains, "the page says that srflow trains every network, but not {}", facts.name);
        let code = facts.authors.trim_start_matches("https://").trim_start_matches("github.com/");
        let iterations = facts.iterations;
        let iterations = match facts.refines() {
            true => format!("{}, {}, {}", iterations.default, iterations.authors, iterations.training),
            false => "none".to_owned(),
        };
        let (paper, code) = match facts.paper {
            "" => ("built-in, [explained](../explanation/networks.md#srflow)".to_owned(), "here".to_owned()),
            paper => (format!("[{}]({paper})", facts.title), format!("[{code}]({})", facts.authors)),
        };
        networks += &format!(
            "| `{}` | {paper} | {} | {} | {iterations} | {code} | {} |\n",
            facts.name,
            with_commas(facts.parameters),
            facts.padding,
            facts.licence,
        );
        let trained: Vec<String> =
            facts.published.iter().map(|weights| format!("`{}`", weights.trained_on)).collect();
        if !trained.is_empty() {
            weights += &format!("- `{}-`: {}\n", facts.name, trained.join(", "));
        }
    }
    let published = all.iter().filter(|facts| !facts.paper.is_empty());
    let titles: Vec<&str> = published.map(|facts| facts.title).collect();
    let (last, others) = titles.split_last().unwrap();
    let titles = format!("{} and {last}", others.join(", "));
    is_listed("../../docs/reference/networks.md", "<!-- networks", &networks);
    is_listed("../../docs/reference/networks.md", "<!-- weights", &weights);
    is_listed("../../README.md", "<!-- networks", &titles);
}

/// Whether `list` is what stands between the comment that starts so and the next one.
fn is_listed(document: &str, comment: &str, list: &str) {
    let text = fs::read_to_string(document).unwrap();
    let start = text.find(comment).unwrap_or_else(|| panic!("{document}: {comment}"));
    let start = start + text[start..].find("-->").unwrap() + "-->".len();
    let end = start + text[start..].find("<!-- end -->").unwrap();
    let list = list.trim_end();
    let wanted = if list.contains('\n') { format!("\n{list}\n") } else { list.to_owned() };
    if text[start..end] == wanted {
        return;
    }
    let write = std::env::var_os("SRFLOW_WRITE_DOCS").is_some();
    assert!(write, "{document} is out of date: run this test with SRFLOW_WRITE_DOCS=1");
    fs::write(document, format!("{}{wanted}{}", &text[..start], &text[end..])).unwrap();
}

/// 5257536 as 5,257,536.
fn with_commas(number: usize) -> String {
    let digits = number.to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|group| std::str::from_utf8(group).unwrap()).collect();
    groups.join(",")
}
