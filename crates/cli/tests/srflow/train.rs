//! `srflow train`: a folder of pairs, a kill, a resume, and broken folders and configurations.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use srflow_core::Size;

use crate::frames::{write_frames, write_pairs};
use crate::refuses;

const SIZE: Size = Size::new(96, 80);

fn make_pairs(dir: &Path, count: usize) {
    write_pairs(dir, count, SIZE, 2.0);
}

fn command(arguments: &[&str]) -> Command {
    let mut command = crate::srflow();
    command.arg("train").args(arguments);
    command
}

fn train(arguments: &[&str]) -> Output {
    command(arguments).output().expect("srflow runs")
}

fn succeed(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Arguments of a short run of the smallest network.
fn small<'a>(data: &'a str, out: &'a str) -> Vec<&'a str> {
    let mut arguments = vec!["--data", data, "--out", out, "--network", "raft-small", "--crop", "64x64"];
    arguments.extend(["--batch", "2", "--iterations", "2", "--set", "checkpoints.every=2"]);
    arguments.extend(["--set", "validation.every=4", "--set", "checkpoints.keep=20"]);
    arguments
}

fn checkpoint(run: &Path, step: u64) -> PathBuf {
    run.join(format!("checkpoints/step-{step:08}"))
}

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<(String, Vec<u8>)> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap())
        .map(|entry| (entry.file_name().into_string().unwrap(), std::fs::read(entry.path()).unwrap()))
        .collect();
    files.sort();
    files
}

#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    make_pairs(&data.join("train"), 5);
    make_pairs(&data.join("val"), 1);
    let data = format!("folder:{}", data.display());
    let [through, killed] = ["through", "killed"].map(|name| dir.path().join(name));
    const STEPS: u64 = 10;
    let run = |out: &Path, more: &[&str]| {
        let out = out.display().to_string();
        let mut command = command(&small(&data, &out));
        command.args(["--steps", &STEPS.to_string(), "--seed", "5", "--threads", "2"]).args(more);
        command.output().unwrap()
    };
    succeed(&run(&through, &[]));

    let stopped = run(&killed, &["--stop-after-step", "7"]);
    assert_eq!(stopped.status.code(), Some(75), "{}", String::from_utf8_lossy(&stopped.stderr));
    assert!(String::from_utf8_lossy(&stopped.stdout).contains("--resume"));
    assert!(!killed.join("report.html").exists(), "it is not finished");
    // As if killed after step 7: the log is ahead of the last checkpoint, that of step 6, and there is a partial checkpoint and
    // the lock of a dead process.
    std::fs::rename(checkpoint(&killed, 7), killed.join("checkpoints/.step-00000007.partial")).unwrap();
    std::fs::remove_file(killed.join("checkpoints/.step-00000007.partial/state.json")).unwrap();
    std::fs::write(killed.join(".lock"), "process 1 on elsewhere\n").unwrap();
    let killed_text = killed.display().to_string();
    let resumed = train(&["--resume", &killed_text, "--threads", "2", "--json"]);
    succeed(&resumed);
    assert!(!killed.join("checkpoints/.step-00000007.partial").exists());
    assert_eq!(files(&checkpoint(&killed, STEPS)), files(&checkpoint(&through, STEPS)));
    for name in ["last.safetensors", "best.safetensors", "config.toml"] {
        let [one, two] = [&through, &killed].map(|run| std::fs::read(run.join(name)).expect(name));
        assert!(one == two, "{name}");
    }

    let summary: Value = serde_json::from_slice(&resumed.stdout).unwrap();
    assert_eq!(summary["steps"], STEPS);
    // The log of the killed run has every step once, like the other's.
    let steps = |run: &Path| -> Vec<(u64, f64)> {
        let text = std::fs::read_to_string(run.join("log.jsonl")).unwrap();
        let records = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        records
            .filter(|record| record["kind"] == "step")
            .map(|record| (record["step"].as_u64().unwrap(), record["loss"].as_f64().unwrap()))
            .collect()
    };
    assert_eq!(steps(&killed), steps(&through));
    assert_eq!(steps(&killed).len() as u64, STEPS);

    refuses(&train(&small(&data, &killed_text)), 1, &["--resume"]);
    refuses(&train(&["--resume", &killed_text, "--batch", "3"]), 1, &["--resume"]);
}

/// SEA-RAFT's own loss, from configuration to weights that a resumed run ends with too.
#[test]
fn a_mixture_of_laplace_distributions_is_trained_and_resumed() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 3);
    let data = format!("folder:{}", dir.path().display());
    let [through, stopped] = ["through", "stopped"].map(|name| dir.path().join(name));
    let run = |out: &Path, more: &[&str]| {
        let out = out.display().to_string();
        let arguments = ["--config", "sea-raft", "--data", &data, "--out", &out, "--network", "sea-raft-s"];
        let sizes = ["--crop", "64x64", "--batch", "2", "--iterations", "2", "--steps", "4"];
        let rest = ["--threads", "2", "--seed", "3", "--set", "checkpoints.every=2"];
        train(&[&arguments[..], &sizes, &rest, more].concat())
    };
    succeed(&run(&through, &[]));
    assert_eq!(run(&stopped, &["--stop-after-step", "2"]).status.code(), Some(75));
    succeed(&train(&["--resume", &stopped.display().to_string(), "--threads", "2"]));
    let [one, other] = [&through, &stopped].map(|run| std::fs::read(run.join("last.safetensors")).unwrap());
    assert!(one == other, "a resumed run ends with the same weights");
    let log = std::fs::read_to_string(through.join("log.jsonl")).unwrap();
    let losses: Vec<f64> = log
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap())
        .filter(|record| record["kind"] == "step")
        .map(|record| record["loss"].as_f64().unwrap())
        .collect();
    assert!(losses.len() == 4 && losses.iter().all(|loss| loss.is_finite()), "{losses:?}");
}

/// Its loss has a part that needs no true flow, with a weight of its own.
#[test]
fn ssa_is_trained_with_its_cyclic_loss() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    make_pairs(&data, 2);
    let (data, out) = (format!("folder:{}", data.display()), dir.path().join("run"));
    let out_text = out.display().to_string();
    let mut arguments = vec!["--config", "ssa", "--data", &data, "--out", &out_text, "--crop", "64x64"];
    arguments.extend(["--batch", "1", "--steps", "2", "--threads", "2"]);
    succeed(&train(&arguments));
    let log = std::fs::read_to_string(out.join("log.jsonl")).unwrap();
    let records = log.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let parts = records.filter(|record| record["kind"] == "step").map(|record| record["parts"].clone());
    let cyclic: Vec<f64> = parts
        .map(|parts| {
            let parts: Vec<(String, f64)> = serde_json::from_value(parts).unwrap();
            parts.into_iter().find(|(name, _)| name == "cyclic").unwrap().1
        })
        .collect();
    assert!(cyclic.len() == 2 && cyclic.iter().all(|part| *part > 0.0), "{cyclic:?}");
    assert!(out.join("last.safetensors").exists());
}

/// The groups of RPKNet's norms, which its weights were trained with.
#[test]
fn settings_of_the_weights_stay_in_a_run() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 2);
    let (weights, run) = (dir.path().join("rpknet.safetensors"), dir.path().join("run"));
    let mut network = srflow_nets::Architecture::RpkNet.init(&Default::default());
    network.set("groups", 4).unwrap();
    srflow_nets::save_network(&network, srflow_nn::StoredAs::F32, &weights).unwrap();
    let (data, out) = (format!("folder:{}", dir.path().display()), run.display().to_string());
    let files =
        ["--data", &data, "--out", &out, "--network", "rpknet", "--weights", weights.to_str().unwrap()];
    let sizes = ["--crop", "64x64", "--batch", "1", "--iterations", "1", "--steps", "1"];
    succeed(&train(&[&files[..], &sizes].concat()));
    assert!(std::fs::read_to_string(run.join("config.toml")).unwrap().contains("groups = 4"));
    let mut trained = srflow_nets::load_network(
        srflow_nets::Architecture::RpkNet,
        &run.join("last.safetensors"),
        &Default::default(),
    )
    .unwrap();
    assert_eq!(*trained.settings()[0].value, 4);
}

#[test]
fn a_folder_that_another_process_trains_in_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 2);
    let (data, out) = (format!("folder:{}", dir.path().display()), dir.path().join("run"));
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join(".lock"), "process 4711 on elsewhere\n").unwrap();
    let lock = std::fs::File::open(out.join(".lock")).unwrap();
    lock.lock().unwrap();
    let begun = train(&small(&data, &out.display().to_string()));
    refuses(&begun, 1, &["process 4711 on elsewhere", "another folder"]);
    assert!(!out.join("config.toml").exists(), "nothing of the other's is touched");
}

/// Without a split `val`, and with weights of the same and of another network.
#[test]
fn a_run_reports_its_start() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(dir.path(), 2);
    let data = format!("folder:{}", dir.path().display());
    let out = dir.path().join("run").display().to_string();
    let weights = dir.path().join("raft.safetensors");
    let network = srflow_nets::Architecture::Raft.init(&Default::default());
    srflow_nets::save_network(&network, srflow_nn::StoredAs::F32, &weights).unwrap();
    let mut arguments = small(&data, &out);
    arguments.extend(["--steps", "1", "--weights", weights.to_str().unwrap()]);
    refuses(&train(&arguments), 1, &["they are the parameters of raft"]);
    assert!(!Path::new(&out).exists(), "no run was begun");

    let network = arguments.iter().position(|argument| *argument == "raft-small").unwrap();
    arguments[network] = "raft";
    let run = train(&arguments);
    succeed(&run);
    let lines = String::from_utf8(run.stderr).unwrap();
    assert!(lines.contains("validation: none") && lines.contains("no best.safetensors"), "{lines}");
    assert!(lines.contains("batch norm: frozen"), "{lines}");
    assert!(lines.contains("step 1/1: ") && lines.contains("loss ") && lines.contains(" left"), "{lines}");
    assert!(String::from_utf8(run.stdout).unwrap().contains("no best.safetensors"));
    let statistics = |path: &Path| {
        let parameters = srflow_nn::read_parameters(path).unwrap().into_iter();
        parameters.filter(|(name, _)| name.contains("running_")).map(|(_, data)| data).collect::<Vec<_>>()
    };
    let kept = statistics(&Path::new(&out).join("last.safetensors"));
    assert!(!kept.is_empty() && kept == statistics(&weights));
}

/// These frames are smaller than the networks' minimum.
#[test]
fn validation_matches_evaluation() {
    let dir = tempfile::tempdir().unwrap();
    make_pairs(&dir.path().join("train"), 2);
    make_pairs(&dir.path().join("val"), 2);
    let data = format!("folder:{}", dir.path().display());
    let run = dir.path().join("run");
    let out = run.display().to_string();
    let short = ["--steps", "2", "--set", "validation.every=2"];
    succeed(&train(&[small(&data, &out), short.to_vec()].concat()));
    let log = std::fs::read_to_string(run.join("log.jsonl")).unwrap();
    let mut records = log.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let validation = records.rfind(|record| record["kind"] == "validation").expect("validated");

    let method = format!("raft-small={}", run.join("last.safetensors").display());
    let output = crate::srflow()
        .args(["eval", "--json", "--split", "val", "--dataset", &data, "--method", &method, "--iters", "2"])
        .output()
        .unwrap();
    succeed(&output);
    let evaluation: Value = serde_json::from_slice(&output.stdout).unwrap();
    let [zero, network] = &evaluation["methods"].as_array().unwrap()[..] else { panic!("two methods") };
    assert_eq!(validation["pairs"], 2);
    assert_eq!(validation["whole"], network["whole"]);
    assert_eq!(validation["zero_epe"], zero["whole"]["epe"]);
}

#[test]
fn wrong_folders_say_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run").display().to_string();
    refuses(&train(&["--out", &out]), 1, &["--data"]);

    let empty = dir.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    refuses(&train(&small(&format!("folder:{}", empty.display()), &out)), 1, &["img1", "empty"]);

    write_frames(&dir.path().join("unknown/frames"), 0..3, SIZE);
    let unknown = format!("folder:{}", dir.path().join("unknown").display());
    refuses(&train(&small(&unknown, &out)), 1, &["true flow", "docs/guides/train.md"]);

    let pairs = dir.path().join("pairs");
    make_pairs(&pairs, 2);
    let pairs = format!("folder:{}", pairs.display());
    let large = ["--data", &pairs, "--out", &out, "--network", "raft-small", "--crop", "512x800"];
    let run = train(&large);
    let said = String::from_utf8(run.stderr).unwrap();
    assert_eq!(run.status.code(), Some(1), "{said}");
    assert!(["_img1.png", "96x80", "--crop"].iter().all(|part| said.contains(part)), "{said}");
    let weights = dir.path().join("none.pth").display().to_string();
    refuses(&train(&[&small(&pairs, &out)[..], &["--weights", &weights]].concat()), 1, &["none.pth"]);
}

#[test]
fn configurations_are_printed_and_their_mistakes_named() {
    let printed = train(&["--config", "srflownet-fdr", "--set", "training.clip=0.5", "--print-config"]);
    succeed(&printed);
    let text = String::from_utf8(printed.stdout).unwrap();
    for line in ["fdr = 0.05", "clip = 0.5", "crop = \"512x800\"", "learning_rate = 0.000125"] {
        assert!(text.contains(line), "{line} in {text}");
    }
    // The output is a configuration.
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mine.toml");
    std::fs::write(&file, &text).unwrap();
    let again = train(&["--config", file.to_str().unwrap(), "--print-config"]);
    assert_eq!(String::from_utf8(again.stdout).unwrap(), text);

    let json = train(&["--config", file.to_str().unwrap(), "--print-config", "--json"]);
    let json: Value = serde_json::from_slice(&json.stdout).unwrap();
    assert_eq!((&json["loss"]["fdr"], &json["data"]["crop"]), (&0.05.into(), &"512x800".into()));

    std::fs::write(&file, "[training]\nbatchsize = 4\n").unwrap();
    let print = |arguments: [&str; 2]| train(&[&arguments[..], &["--print-config"]].concat());
    refuses(&print(["--config", file.to_str().unwrap()]), 1, &["mine.toml", "line 2"]);
    refuses(&print(["--config", "srflownet"]), 1, &["srflownet-fdr"]);
    refuses(&print(["--set", "training.batch=none"]), 1, &["training.batch"]);
    refuses(&print(["--set", "loss.sequence=mixture-of-laplace"]), 1, &["SEA-RAFT", "\"l1\""]);
    refuses(&train(&["--config", "skflow"]), 2, &["--out"]);
}

/// The loss of the first step on one pair that is made, and on the same pair in files.
#[test]
fn made_data_trains_as_its_files_do() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let write = |arguments: &[&str]| succeed(&crate::srflow().args(arguments).output().unwrap());
    let (shapes, rendered) = (path("shapes"), path("rendered"));
    let common = ["--size", "64x64", "--seed", "3", "--flow-format", "flo", "--threads", "2"];
    write(&[&["shapes", "--out", &shapes, "--pairs", "1", "--motion", "1,2"][..], &common].concat());
    let one = ["--scenes", "1", "--frames", "1", "--splits", "1,0,0", "--preset", "wild", "--noise", "4"];
    write(&[&["render", "--out", &rendered][..], &one, &common].concat());

    let settings = dir.path().join("made.toml");
    let text = "[data.shapes]\npairs = 1\nsize = \"64x64\"\nmotion = [1, 2]\nseed = 3\n\
                [data.rendered]\nscenes = 1\nframes = 1\nsize = \"64x64\"\nseed = 3\n[augmentation]\nkind = \"none\"\n";
    std::fs::write(&settings, text).unwrap();
    let settings = settings.display().to_string();
    let loss = |data: &str, out: &str| -> f64 {
        let out = path(out);
        let mut arguments = small(data, &out);
        arguments.extend(["--config", &settings, "--steps", "1", "--threads", "2"]);
        arguments.extend(["--set", "data.rendered.recording.noise=4"]);
        succeed(&train(&arguments));
        let text = std::fs::read_to_string(Path::new(&out).join("log.jsonl")).unwrap();
        serde_json::from_str::<Value>(text.lines().next().unwrap()).unwrap()["loss"].as_f64().unwrap()
    };
    let of_files = [format!("chairs:{shapes}@all"), format!("srflow:{rendered}")];
    for (number, made, files) in [(0, "shapes:", &of_files[0]), (1, "rendered:", &of_files[1])] {
        let losses = [loss(made, &format!("made-{number}")), loss(files, &format!("files-{number}"))];
        assert_eq!(losses[0], losses[1], "{made}");
    }
}

#[test]
fn a_resumed_run_goes_on_with_the_same_made_pairs() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str, workers: &str, more: &[&str]| {
        let out = dir.path().join(name).display().to_string();
        let mut arguments = small("shapes:*2", &out);
        let workers = format!("data.workers={workers}");
        arguments.extend(["--data", "rendered:", "--steps", "6", "--threads", "2", "--set", &workers]);
        arguments.extend(["--set", "data.shapes.pairs=3", "--set", "data.rendered.scenes=1"]);
        arguments.extend(["--set", "data.rendered.frames=3", "--set", "data.rendered.size=64x64"]);
        train(&[&arguments, more].concat())
    };
    succeed(&run("through", "3", &[]));
    let stopped = run("stopped", "1", &["--stop-after-step", "3"]);
    assert_eq!(stopped.status.code(), Some(75), "{}", String::from_utf8_lossy(&stopped.stderr));
    let [through, resumed] = ["through", "stopped"].map(|name| dir.path().join(name));
    succeed(&train(&["--resume", &resumed.display().to_string(), "--threads", "2"]));
    let [one, two] = [&through, &resumed].map(|run| std::fs::read(run.join("last.safetensors")).unwrap());
    assert!(one == two);
}

#[test]
fn made_data_that_cannot_be_made_says_why() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run").display().to_string();
    let empty = dir.path().display().to_string();
    let empty = format!("shapes:{empty}");
    for (data, set, parts) in [
        ("shapes:/no/such/dir", "data.workers=1", &["`shapes:/no/such/dir`: ", "a folder of images"][..]),
        (&empty, "data.workers=1", &["a folder with images"]),
        ("rendered:nonsense", "data.workers=1", &["`rendered:nonsense`: ", "`builtin`, `ict:DIR`"]),
        ("rendered:ict:/no/such/dir", "data.workers=1", &["/no/such/dir: ", "head model"]),
        ("shapes:", "data.shapes.size=40x40", &["data.shapes.size = 40x40", "at least the crop, 64x64"]),
        ("rendered:", "data.rendered.size=64x40", &["data.rendered.size = 64x40"]),
        ("shapes:", "data.shapes.pairs=0", &["data.shapes.pairs = 0"]),
        ("shapes:", "data.shapes.motion=[5, 1]", &["data.shapes.motion = 5,1: expected two lengths"]),
        ("shapes:", "data.shapes.textures=dir", &["data.shapes.textures: unknown key", "motion, "]),
        ("rendered:", "data.rendered.background=#12", &["data.rendered.background: `#12`"]),
        ("rendered:", "data.rendered.motion=5", &["5: No such file or directory"]),
        ("rendered:", "data.rendered.noise=4", &["data.rendered.noise: unknown key", "background, "]),
        (
            "rendered:",
            "data.rendered.recording.lamps=3",
            &["data.rendered.recording.lamps = 3: expected 0 to 1"],
        ),
    ] {
        refuses(&train(&[&small(data, &out)[..], &["--set", set]].concat()), 1, parts);
    }
    refuses(
        &train(&[&small("shapes:", &out)[..], &["--validation", "shapes:"]].concat()),
        1,
        &["validation.data"],
    );
}
