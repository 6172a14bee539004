//! `srflow ablation`: its table, the paper's table, and an interrupted run.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::SystemTime;

use serde_json::Value;
use srflow_core::Size;

use crate::frames::write_pairs;

/// Pairs for training and a pair to score on.
fn make_data(folder: &Path) -> String {
    write_pairs(&folder.join("train"), 2, Size::new(72, 64), 1.5);
    write_pairs(&folder.join("test"), 1, Size::new(72, 64), 1.5);
    format!("folder:{}", folder.display())
}

fn command(data: &str, out: &Path, rows: &str, more: &[&str]) -> Command {
    let mut command = crate::srflow();
    command.args(["ablation", "--config", "cpu-small", "--data", data, "--rows", rows]).args(SETTINGS);
    command.arg("--out").arg(out).args(more);
    if !more.contains(&"--seeds") {
        command.args(["--seeds", "1,2"]);
    }
    command
}

const SETTINGS: [&str; 10] =
    ["--crop", "64x64", "--batch", "1", "--iterations", "1", "--steps", "2", "--set", "checkpoints.every=1"];

fn succeed(mut command: Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

const RUNS: [&str; 4] = ["none-seed-1", "none-seed-2", "fdr-seed-1", "fdr-seed-2"];

fn results(out: &Path) -> Vec<(PathBuf, SystemTime)> {
    let files = RUNS.iter().map(|run| out.join(run).join("test.json")).filter(|path| path.exists());
    files.map(|path| (path.clone(), path.metadata().unwrap().modified().unwrap())).collect()
}

#[test]
fn the_table_stands_beside_the_papers_and_a_stopped_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let data = make_data(&folder.path().join("data"));
    let [through, stopped] = ["through", "stopped"].map(|name| folder.path().join(name));
    let output = succeed(command(&data, &through, "none,fdr", &[]));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(
        text.contains(
            "RAFT-S, 2 steps, seeds 1, 2; EPE of zero flow 1.5000 px in folder, test split (pairs: 1)"
        ),
        "{text}"
    );
    let ours = text.find("all pixels: mean over the seeds").expect(&text);
    let spread = text.find("all pixels: standard deviation over the seeds").expect(&text);
    let paper = text.find("The paper's Table V").expect(&text);
    assert!(ours < spread && spread < paper, "{text}");
    assert!(text[ours..paper].contains("FDR") && !text[..paper].contains("TVR"), "only what was run: {text}");
    assert!(text[paper..].contains("SRFlowNet-TVR") && text[paper..].contains("0.4056"), "{text}");
    let json: Value = serde_json::from_slice(&std::fs::read(through.join("ablation.json")).unwrap()).unwrap();
    let epe = |cell: &Value| cell["tests"][0]["whole"]["epe"].as_f64().unwrap();
    let cells = json.as_array().unwrap();
    assert_eq!(cells.len(), 4);
    assert!(cells.iter().all(|cell| epe(cell).is_finite() && cell["tests"][0]["zero_epe"] == 1.5), "{json}");
    let mean = |variant: &str| -> f64 {
        cells.iter().filter(|cell| cell["variant"] == variant).map(epe).sum::<f64>() / 2.0
    };
    assert!(text[ours..spread].contains(&format!("{:.4}", mean("fdr"))), "{text}");

    // The same, with the first row finished and the second interrupted.
    succeed(command(&data, &stopped, "none", &["--seeds", "1"]));
    let mut half = crate::srflow();
    half.args(["train", "--config", "cpu-small", "--data", &data, "--seed", "2"]).args(SETTINGS);
    half.args(["--stop-after-step", "1", "--out"]).arg(stopped.join(RUNS[1]));
    assert_eq!(half.output().unwrap().status.code(), Some(75));
    let finished = results(&stopped);
    assert_eq!(finished.len(), 1);
    succeed(command(&data, &stopped, "none,fdr", &[]));
    let read = |out: &Path, name: &str| std::fs::read(out.join(name)).unwrap();
    assert_eq!(read(&stopped, "ablation.json"), read(&through, "ablation.json"));
    let now = results(&stopped);
    assert!(finished.iter().all(|result| now.contains(result)), "what was finished is not run again");

    // Once more: everything is finished.
    succeed(command(&data, &stopped, "none,fdr", &["--json"]));
    assert_eq!(results(&stopped), now);
    let refused = command(&data, &stopped, "none", &["--learning-rate", "1e-5"]).output().unwrap();
    let error = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success() && error.contains("none-seed-1") && error.contains("--out"), "{error}");

    // The initial weights are scored once for all seeds.
    let without = command(&data, &folder.path().join("start"), "start", &[]).output().unwrap();
    let error = String::from_utf8(without.stderr).unwrap();
    assert!(!without.status.success() && error.contains("--weights"), "{error}");
    let weights = through.join("fdr-seed-2/last.safetensors");
    let more = ["--json", "--weights", weights.to_str().unwrap()];
    let output = succeed(command(&data, &folder.path().join("start"), "start", &more));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let start = json.as_array().unwrap();
    assert_eq!(start.len(), 1);
    assert_eq!(start[0]["steps"], 0);
    assert_eq!(start[0]["tests"], cells[3]["tests"], "the same weights on the same pairs");

    // A control on other data, and scores on two datasets, of what is finished too.
    let without = command(&data, &stopped, "control", &[]).output().unwrap();
    let error = String::from_utf8(without.stderr).unwrap();
    assert!(!without.status.success() && error.contains("--control"), "{error}");
    write_pairs(&folder.path().join("other/train"), 2, Size::new(72, 64), 0.5);
    let other = format!("folder:{}", folder.path().join("other").display());
    let (faces, others) = (format!("{data}@test"), format!("{other}@train"));
    let more = ["--json", "--weights", weights.to_str().unwrap(), "--control", &other, "--test", &faces];
    let more = [&more[..], &["--test", &others, "--seeds", "1"]].concat();
    let output = succeed(command(&data, &folder.path().join("both"), "start,control,none", &more));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let cells = json.as_array().unwrap();
    let zero = |cell: &Value| [0, 1].map(|test| cell["tests"][test]["zero_epe"].as_f64().unwrap());
    assert_eq!(cells.iter().map(zero).collect::<Vec<_>>(), [[1.5, 0.5]; 3]);
    let config =
        |run: &str| std::fs::read_to_string(folder.path().join("both").join(run).join("config.toml"));
    assert!(
        config("control-seed-1").unwrap().contains(&other) && config("none-seed-1").unwrap().contains(&data)
    );
    let finished = std::fs::read(folder.path().join("both/none-seed-1/last.safetensors")).unwrap();
    let again = ["--json", "--weights", weights.to_str().unwrap(), "--test", &others, "--seeds", "1"];
    let output = succeed(command(&data, &folder.path().join("both"), "none", &again));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json[0]["tests"].as_array().unwrap().len(), 1);
    assert_eq!(json[0]["tests"][0], cells[2]["tests"][1], "scored again, not trained again");
    assert_eq!(std::fs::read(folder.path().join("both/none-seed-1/last.safetensors")).unwrap(), finished);
}
