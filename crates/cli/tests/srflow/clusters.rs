//! Work that job engines divide, end and start again: parts, merges, hashes, signals.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Value, json as value};

use srflow_core::{FlowField, Size};
use srflow_files::{RunLock, write_flow};

use crate::frames::{write_frames, write_pairs};
use crate::tree::tree;
use crate::{json, refuses, succeeds};

/// A dataset of generic pairs: the fastest to make.
const PAIRS: [&str; 6] = ["--pairs", "11", "--size", "48x32", "--seed", "5"];

fn shapes(out: &Path, more: &[&str]) -> Command {
    let mut command = crate::srflow();
    command.args(["shapes", "--out", out.to_str().unwrap()]).args(PAIRS).args(more);
    command
}

fn merge(parts: &[&Path], out: &Path, more: &[&str]) -> Output {
    crate::srflow().arg("merge").args(parts).arg("--out").arg(out).args(more).output().unwrap()
}

#[test]
fn the_parts_of_a_job_array_merge_to_the_bytes_of_one_run() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    succeeds(&shapes(&at("whole"), &[]).output().unwrap());
    for task in 1..=3 {
        let out = at(&format!("part-{task}"));
        let mut command = shapes(&out, &["--shard", "auto", "--json"]);
        let variables = [("ID", task), ("MIN", 1), ("MAX", 3), ("STEP", 1), ("COUNT", 3)];
        command.envs(variables.map(|(name, value)| (format!("SLURM_ARRAY_TASK_{name}"), value.to_string())));
        let report = json(&command.output().unwrap());
        assert_eq!((&report["shard"]["number"], &report["shard"]["of"]), (&value!(task), &value!(3)));
        assert_eq!(report["shard"]["from"][0], format!("SLURM_ARRAY_TASK_ID={task}"));
        assert_eq!(report["is_whole"], false);
    }
    let parts = [1, 2, 3].map(|task| at(&format!("part-{task}")));
    let [one, two, three] = parts.each_ref().map(PathBuf::as_path);

    // A part is missing: nothing is written, or what there is.
    let merged = at("merged");
    refuses(
        &merge(&[one, three], &merged, &[]),
        1,
        &["4 of 11 pairs are in none of the 2 parts", "pair 00004"],
    );
    assert!(!merged.exists());
    let some = json(&merge(&[one, three], &merged, &["--partial", "--json"]));
    assert_eq!(
        (&some["merged"], &some["missing"], &some["complete"]),
        (&value!(7), &value!(4), &value!(false))
    );
    assert!(!merged.join("SHA256SUMS").exists());
    // A later merge adds the rest; a third has nothing to do.
    let rest = json(&merge(&[one, two, three], &merged, &["--json"]));
    assert_eq!((&rest["merged"], &rest["complete"]), (&value!(4), &value!(true)));
    assert_eq!(tree(&merged), tree(&at("whole")));
    assert_eq!(json(&merge(&[one, two, three], &merged, &["--json"]))["merged"], 0);
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let inode = |dir: &Path| fs::metadata(dir.join("data/00001_flow.npz16")).unwrap().ino();
        assert_eq!(inode(one), inode(&merged), "a link, which takes no space");
    }

    let copied = at("copied");
    let report = json(&merge(&[three, two, one], &copied, &["--copy", "--json"]));
    assert_eq!((&report["linked"], &report["copied"]), (&value!(0), &value!(44)));
    assert_eq!(tree(&copied), tree(&merged));

    // The same pairs twice are named, and may be there; with other bytes they may not.
    let doubled = json(&merge(&[one, &copied], &at("doubled"), &["--json"]));
    assert_eq!((&doubled["doubled"], &doubled["doubled_names"][0]), (&value!(3), &value!("pair 00001")));
    fs::write(copied.join("data/00002_occlusion.png"), "damaged").unwrap();
    let refused = merge(&[one, &copied], &at("damaged"), &[]);
    refuses(&refused, 1, &["00002_occlusion.png", "have different bytes"]);

    // Parts of other datasets.
    let other = at("other");
    let mut seed_6 = crate::srflow();
    seed_6
        .args(["shapes", "--pairs", "11", "--size", "48x32", "--seed", "6", "--shard", "3/3", "--out"])
        .arg(&other);
    succeeds(&seed_6.output().unwrap());
    refuses(&merge(&[one, two, &other], &at("mixed"), &[]), 1, &["seed is 6", "it is 5"]);
    let manifest = fs::read_to_string(three.join("shapes.json")).unwrap();
    let version = env!("CARGO_PKG_VERSION");
    fs::write(other.join("shapes.json"), manifest.replace(version, "0.0.1")).unwrap();
    refuses(&merge(&[one, two, &other], &at("mixed"), &[]), 1, &["srflow_version is \"0.0.1\""]);
    fs::create_dir(at("empty")).unwrap();
    refuses(&merge(&[&at("empty")], &at("mixed"), &[]), 1, &["found no dataset.json"]);
    refuses(&merge(&[one, &at("empty")], &at("mixed"), &[]), 1, &["expected a part"]);
    assert!(!at("mixed").exists());
    refuses(
        &shapes(&at("none"), &["--shard", "auto"]).env_remove("SLURM_ARRAY_TASK_ID").output().unwrap(),
        2,
        &["--shard auto: expected the variables of a job engine"],
    );
}

#[test]
fn parts_of_scenes_and_of_clips_merge_too() {
    let dir = tempfile::tempdir().unwrap();
    let scenes = ["render", "--scenes", "1", "--frames", "3", "--size", "110x160", "--splits", "1,0,0"];
    let clips = ["mer", "synth", "--subjects", "1", "--clips", "2", "--side", "64", "--fps", "30"];
    // Heads of the first look are made in half the time.
    for (kind, arguments) in [("scenes", &scenes[..]), ("clips", &clips[..])] {
        let at = |name: &str| dir.path().join(format!("{kind}-{name}"));
        let make = |name: &str, shard: &str| {
            let out = at(name);
            succeeds(
                &crate::srflow()
                    .args(arguments)
                    .arg("--out")
                    .arg(out)
                    .args(["--look", "1", "--shard", shard])
                    .output()
                    .unwrap(),
            )
        };
        make("whole", "1/1");
        assert!(make("one", "1/2").contains("`srflow merge` joins parts"));
        make("two", "2/2");
        let merged = at("merged");
        succeeds(&merge(&[&at("one"), &at("two")], &merged, &[]));
        assert_eq!(tree(&merged), tree(&at("whole")), "{kind}");
        let check = crate::srflow().args(["check", "--hashes", "--json"]).arg(&merged).output().unwrap();
        assert_eq!(json(&check)["hashed_files"], tree(&merged).len() - 1, "{kind}");
    }

    // The hashes are those of sha256sum, and tell every change.
    let data = dir.path().join("scenes-merged");
    let check =
        |more: &[&str]| crate::srflow().args(["check", "--json"]).arg(&data).args(more).output().unwrap();
    if let Ok(output) =
        Command::new("sha256sum").args(["--check", "--strict", "SHA256SUMS"]).current_dir(&data).output()
    {
        let said = succeeds(&output);
        assert_eq!(said.lines().count(), tree(&data).len() - 1, "{said}");
    } else {
        eprintln!("skipped: sha256sum: not on the PATH");
    }
    let report = json(&check(&["--hashes", "--rerender", "2", "--seed", "3"]));
    assert_eq!(report["hashed_files"], tree(&data).len() - 1);
    assert_eq!(report["rerendered"]["pairs"].as_array().unwrap().len(), 2);
    assert_eq!(report["rerendered"]["problems"], value!([]));

    let problems = |more: &[&str]| -> Vec<Value> {
        let output = check(more);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let all = [&report["hash_problems"], &report["rerendered"]["problems"]];
        all.into_iter().flat_map(|problems| problems.as_array().cloned().unwrap_or_default()).collect()
    };
    let changed = data.join("train/alpha/scene-0000/00001.png");
    let original = fs::read(&changed).unwrap();
    fs::remove_file(&changed).unwrap(); // not through the link
    fs::write(&changed, [&original[..], b"x"].concat()).unwrap();
    for arguments in [&["--hashes"][..], &["--rerender", "9"]] {
        let found = problems(arguments);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0]["file"].as_str().unwrap().ends_with("alpha/scene-0000/00001.png"), "{found:?}");
    }
    fs::write(&changed, original).unwrap();
    let hashes = data.join("SHA256SUMS");
    let text = fs::read_to_string(&hashes).unwrap();
    let (left_out, others): (Vec<&str>, Vec<&str>) =
        text.split_inclusive('\n').partition(|line| line.contains("flow"));
    fs::write(&hashes, others.concat()).unwrap();
    assert_eq!(problems(&["--hashes"]).len(), left_out.len());
    for line in
        ["no hash", &format!("{}  ../outside", "0".repeat(64)), &format!("{}  /etc/passwd", "0".repeat(64))]
    {
        fs::write(&hashes, line).unwrap();
        let found = problems(&["--hashes"]);
        assert!(found[0]["what"].as_str().unwrap().starts_with("line 1: expected a SHA-256"), "{found:?}");
    }
}

#[test]
fn an_evaluation_is_divided_and_continued() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("pairs");
    write_pairs(&data, 7, Size::new(48, 40), 1.5);
    let eval = |out: &str, more: &[&str]| {
        let mut command = crate::srflow();
        command.args(["eval", "--json", "--method", "farneback", "tvl1", "--small-motion", "2"]);
        command.args(["--dataset", &format!("folder:{}", data.display()), "--out"]).arg(dir.path().join(out));
        command.args(more).output().unwrap()
    };
    // Without what depends on the machine, and the command.
    let scores = |output: &Output| {
        let mut value = json(output);
        for method in value["methods"].as_array_mut().unwrap() {
            method["pairs"].as_array_mut().unwrap().iter_mut().for_each(|pair| pair["seconds"] = Value::Null);
        }
        (value["methods"].clone(), value["pairs"].clone())
    };
    let whole = scores(&eval("whole", &[]));
    for (part, pairs) in [("1/3", 2), ("2/3", 2), ("3/3", 3)] {
        let report = json(&eval("parts", &["--shard", part]));
        assert_eq!((&report["pairs"], &report["shard"]["of"]), (&value!(pairs), &value!(3)));
    }
    let parts = dir.path().join("parts");
    assert!(!parts.join("scores.json").exists() && parts.join("scored/2-of-3.jsonl").exists());

    // As if a part had been killed while it wrote, and a pair had changed since.
    let log = parts.join("scored/1-of-3.jsonl");
    let text = fs::read_to_string(&log).unwrap();
    let half = text.find('\n').unwrap() + 40;
    fs::write(&log, &text[..half]).unwrap();
    write_flow(&data.join("p6_flow.flo"), &FlowField::filled(48, 40, [0.5, 0.25])).unwrap();
    let part = RunLock::take_part(&parts.join("scored"), "1-of-3").unwrap();
    refuses(&eval("parts", &[]), 1, &["another process is writing into this folder"]);
    refuses(&eval("parts", &["--shard", "1/3"]), 1, &["another process is writing into this folder"]);
    drop(part);
    let changed = scores(&eval("parts", &[]));
    assert_ne!(changed, whole);
    assert_eq!(changed, scores(&eval("afresh", &[])));
    assert!(parts.join("report.html").exists() && !parts.join("scored").exists());

    let without_out = crate::srflow()
        .args(["eval", "--shard", "1/2", "--dataset"])
        .arg(format!("folder:{}", data.display()))
        .output();
    refuses(&without_out.unwrap(), 2, &["--shard needs --out DIR too"]);
    refuses(&eval("files", &["--method", "files:flows", "--shard", "1/2"]), 1, &["flows"]);
}

#[test]
fn several_sequences_are_divided() {
    let dir = tempfile::tempdir().unwrap();
    let folders = ["anna", "ben", "carl"].map(|name| dir.path().join(name));
    for folder in &folders {
        write_frames(folder, 0..3, Size::new(32, 24));
    }
    let out = dir.path().join("flows");
    let flow = |more: &[&str]| {
        let mut command = crate::srflow();
        command.args(["flow", "--json", "--method", "farneback", "-o"]).arg(&out).args(&folders).args(more);
        command.output().unwrap()
    };
    let report = json(&flow(&["--shard", "2/2"]));
    let names: Vec<&String> = report["sequences"].as_object().unwrap().keys().collect();
    assert_eq!(names, ["ben", "carl"]);
    assert_eq!(report["sequences"]["ben"]["pairs"].as_array().unwrap().len(), 2);
    assert!(!out.join("anna").exists());
    json(&flow(&["--shard", "1/2"]));
    for name in ["anna", "ben", "carl"] {
        assert!(out.join(name).join("1.flo").exists(), "{name}");
    }
    let twice =
        crate::srflow().args(["flow", "-o"]).arg(&out).args([&folders[0], &folders[0]]).output().unwrap();
    refuses(&twice, 2, &["a name of its own"]);
    let one =
        crate::srflow().args(["flow", "--shard", "1/2", "-o"]).arg(&out).arg(&folders[0]).output().unwrap();
    refuses(&one, 2, &["--shard divides several videos"]);
}

/// Asks a program to end.
#[cfg(unix)]
fn terminate(child: &std::process::Child) {
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
}

/// Waits until a file is there.
#[cfg(unix)]
fn wait_for(child: &mut std::process::Child, is_there: impl Fn() -> bool) {
    while !is_there() {
        assert!(child.try_wait().unwrap().is_none(), "it ended early");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

#[cfg(unix)]
#[test]
fn a_signal_ends_a_run_that_the_same_command_continues() {
    use std::process::Stdio;
    let dir = tempfile::tempdir().unwrap();
    let [through, ended] = ["through", "ended"].map(|name| dir.path().join(name));
    let larger = |out: &Path| {
        let mut command = crate::srflow();
        command
            .args(["shapes", "--pairs", "150", "--size", "256x192", "--seed", "5", "--json", "--out"])
            .arg(out);
        command
    };
    let mut child = larger(&ended).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let flow_files = || {
        fs::read_dir(ended.join("data"))
            .into_iter()
            .flatten()
            .flatten()
            .filter(|entry| entry.file_name().to_string_lossy().ends_with("_flow.npz16"))
            .count()
    };
    wait_for(&mut child, || flow_files() > 0);
    terminate(&child);
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(75), "{output:?}");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("the same command continues"), "{said}");
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert!(
        report["stopped"] == true || report["error"].as_str().is_some_and(|text| text.contains("are left")),
        "{report}"
    );
    let made = flow_files() as u64;
    assert!(made < 150, "it had time to make all");

    assert_eq!(json(&larger(&ended).output().unwrap())["made"], 150 - made);
    assert_eq!(json(&larger(&through).output().unwrap())["made"], 150);
    assert_eq!(tree(&ended), tree(&through));
}

/// Many parts, as on a cluster: some are killed and run again, some are given to two processes at a time, and others share a folder.
#[cfg(unix)]
#[test]
fn nothing_is_lost_where_parts_are_killed_and_given_twice() {
    use std::process::{Child, Stdio};
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let pairs = ["--pairs", "96", "--size", "96x64", "--seed", "5", "--threads", "1"];
    let part = |number: usize, out: &Path| {
        let mut command = crate::srflow();
        command.arg("shapes").args(pairs).args(["--shard", &format!("{number}/12"), "--out"]).arg(out);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let ends = |child: Child| succeeds(&child.wait_with_output().unwrap());
    succeeds(&crate::srflow().arg("shapes").args(pairs).arg("--out").arg(at("whole")).output().unwrap());

    for number in 1..=8 {
        let out = at(&format!("part-{number}"));
        let mut first = part(number, &out).spawn().unwrap();
        let begun = || fs::read_dir(out.join("data")).is_ok_and(|files| files.count() > number);
        while !begun() && first.try_wait().unwrap().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        match number % 4 {
            0 => _ = Command::new("kill").args(["-TERM", &first.id().to_string()]).output().unwrap(),
            1 => first.kill().unwrap(),
            // Two processes, of which the second one begins while the first one writes.
            _ => _ = ends(part(number, &out).spawn().unwrap()),
        }
        let first = first.wait_with_output().unwrap();
        // The signal may have come after the end.
        match number % 4 {
            0 => assert!([Some(0), Some(75)].contains(&first.status.code()), "{first:?}"),
            1 => assert!([Some(0), None].contains(&first.status.code()), "{first:?}"),
            _ => _ = succeeds(&first),
        }
        ends(part(number, &out).spawn().unwrap());
    }
    // Those that begin at the same time in one folder.
    let shared: Vec<Child> =
        [9, 10, 11, 12, 9, 12].map(|number| part(number, &at("shared")).spawn().unwrap()).into();
    for child in shared {
        ends(child);
    }

    let mut parts: Vec<PathBuf> = (1..=8).map(|number| at(&format!("part-{number}"))).collect();
    parts.push(at("shared"));
    let parts: Vec<&Path> = parts.iter().map(PathBuf::as_path).collect();
    // As a merge leaves them that is killed while it hashes, and while it copies.
    let (hashes, copy) = (".SHA256SUMS.7-1.partial", "data/.00096_img1.png.7-2.partial");
    for (name, more, left) in [("linked", &[][..], &[hashes][..]), ("copied", &["--copy"], &[hashes, copy])] {
        let merged = at(name);
        succeeds(&merge(&parts[..3], &merged, &[more, &["--partial"]].concat()));
        for file in left {
            fs::write(merged.join(file), "half").unwrap();
        }
        let report = json(&merge(&parts, &merged, &[more, &["--json"]].concat()));
        assert_eq!((&report["merged"], &report["complete"]), (&value!(72), &value!(true)));
        assert_eq!(tree(&merged), tree(&at("whole")), "{name}");
        let report =
            json(&crate::srflow().args(["check", "--hashes", "--json"]).arg(&merged).output().unwrap());
        assert_eq!(report["hashed_files"], tree(&merged).len() - 1);
    }
}

#[cfg(unix)]
#[test]
fn a_signal_ends_training_with_a_checkpoint() {
    use std::process::Stdio;
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let mut command = crate::srflow();
    command.args([
        "train",
        "--data",
        "shapes:",
        "--network",
        "raft-small",
        "--crop",
        "64x64",
        "--batch",
        "1",
    ]);
    command.args(["--iterations", "1", "--steps", "100000", "--threads", "1", "--out"]).arg(&run);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for(&mut child, || {
        fs::read_to_string(run.join("log.jsonl")).is_ok_and(|log| log.lines().count() > 2)
    });
    terminate(&child);
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(75), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("--resume"), "{output:?}");
    let log = fs::read_to_string(run.join("log.jsonl")).unwrap();
    let last: Value = serde_json::from_str(log.lines().last().unwrap()).unwrap();
    let step = last["step"].as_u64().unwrap();
    assert!(run.join(format!("checkpoints/step-{step:08}")).is_dir(), "nothing of {step} steps is lost");
}
