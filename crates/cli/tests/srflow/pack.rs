//! `srflow pack`, and reading what it writes: from disk, from a server, from a server that fails, and by other programs.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Read as _, Seek as _, SeekFrom, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use serde_json::Value;
use srflow_core::FlowField;
use srflow_files::{read_flow, write_flow};

use crate::tree::tree;
use crate::{fails, json, refuses, succeeds};

/// A dataset with every kind of file: 4 pairs for training, 4 for testing. It is rendered once.
fn rendered() -> &'static Path {
    static RENDERED: OnceLock<PathBuf> = OnceLock::new();
    RENDERED.get_or_init(|| {
        let out = crate::binary().with_file_name("dataset-to-pack");
        let _ = fs::remove_dir_all(&out); // of an earlier test run
        let mut command = crate::srflow();
        command.args(["render", "--scenes", "2", "--frames", "4", "--size", "110x160", "--seed", "4"]);
        // Heads of the first look are made in half the time.
        command.args(["--splits", "0.5,0,0.5", "--backward", "--depth", "--regions", "--look", "1"]);
        command.arg("--out").arg(&out);
        succeeds(&command.output().unwrap());
        out
    })
}

fn pack(dir: &Path, out: &Path, more: &[&str]) -> Output {
    crate::srflow().arg("pack").arg(dir).arg("--out").arg(out).args(more).output().unwrap()
}

/// Two pairs in each tar.
const SMALL: [&str; 2] = ["--shard-size", "600kB"];

/// Scores of every pair with the method farneback, by the pair's name.
fn scores(dataset: &str, more: &[&str]) -> BTreeMap<String, f64> {
    let mut command = crate::srflow();
    command.args(["eval", "--dataset", dataset, "--method", "farneback", "--json"]).args(more);
    let report = json(&command.output().unwrap());
    let methods = report["methods"].as_array().unwrap();
    let method = methods.iter().find(|method| method["name"] == "farneback").unwrap();
    let pairs = method["pairs"].as_array().unwrap().iter();
    let scores: BTreeMap<String, f64> = pairs
        .map(|pair| (pair["pair"].as_str().unwrap().to_owned(), pair["whole"]["epe"].as_f64().unwrap()))
        .collect();
    assert!(!scores.is_empty(), "{report}");
    scores
}

#[test]
fn scores_are_those_of_the_dataset_within_the_rounding() {
    let folder = tempfile::tempdir().unwrap();
    let original = scores(&format!("srflow:{}", rendered().display()), &["--split", "all"]);
    assert_eq!(original.len(), 8);
    for (flow, error) in [("npy", 1.0 / 256.0), ("npy32", 1e-9), ("png", 1.0 / 128.0), ("npz16", 1e-9)] {
        let out = folder.path().join(flow);
        let report = json(&pack(rendered(), &out, &["--flow", flow, "--json"]));
        assert_eq!((&report["pairs"], &report["packed"], &report["tars"]), (&8.into(), &8.into(), &2.into()));
        assert!(report["flow_error"].as_f64().unwrap() <= error, "{report}");
        let packed = scores(&format!("wds:{}", out.display()), &["--split", "all"]);
        assert_eq!(packed.keys().collect::<Vec<_>>(), original.keys().collect::<Vec<_>>(), "{flow}");
        for (name, score) in &original {
            assert!((packed[name] - score).abs() <= error * 1.5, "{flow} {name}: {} {score}", packed[name]);
        }
        // Pairs are the same without the index, which only says where they are.
        fs::remove_file(out.join("index.jsonl")).unwrap();
        assert_eq!(scores(&format!("wds:{}", out.display()), &["--split", "all"]), packed);
        let tars = format!("wds:{}", out.join("test-{000000..000000}.tar").display());
        assert_eq!(scores(&tars, &[]).len(), 4);
    }
}

#[test]
fn backward_flow_is_that_of_the_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    json(&pack(rendered(), &out, &["--flow", "npz16", "--json"]));
    // Pairs have the name of their first frame in time, those of the dataset that of the frame the flow starts from.
    let values = |dataset: String| scores(&dataset, &["--split", "all"]).into_values().collect::<Vec<f64>>();
    let packed = values(format!("wds-backward:{}", out.display()));
    assert_eq!(packed, values(format!("srflow-backward:{}", rendered().display())));
    assert_ne!(packed, values(format!("wds:{}", out.display())));

    let shapes = folder.path().join("shapes");
    succeeds(
        &crate::srflow()
            .args(["shapes", "--pairs", "2", "--size", "64x48", "--out"])
            .arg(&shapes)
            .output()
            .unwrap(),
    );
    let without = folder.path().join("without");
    json(&pack(&shapes, &without, &["--json"]));
    let dataset = format!("wds-backward:{}", without.display());
    let output = crate::srflow().args(["eval", "--dataset", &dataset, "--split", "all"]).output().unwrap();
    refuses(&output, 1, &["expected pairs with flow_backward", "--backward"]);
}

#[test]
fn region_maps_are_read_too() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    succeeds(&pack(rendered(), &out, &["--flow", "npz16"]));
    let regions = |dataset: String| {
        let mut command = crate::srflow();
        command.args(["eval", "--dataset", &dataset, "--method", "farneback", "--regions", "--json"]);
        let report = json(&command.output().unwrap());
        let methods = report["methods"].as_array().unwrap().iter();
        methods.map(|method| method["regions"].clone()).collect::<Vec<Value>>()
    };
    let own = regions(format!("srflow:{}", rendered().display()));
    assert!(own[0]["skin"].is_object(), "{own:?}");
    assert_eq!(regions(format!("wds:{}", out.display())), own);
}

#[test]
fn the_parts_of_the_flow_are_packed_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let [set, out] = ["set", "packed"].map(|name| folder.path().join(name));
    let mut command = crate::srflow();
    command.args(["render", "--scenes", "1", "--frames", "2", "--size", "110x160", "--splits", "0,0,1"]);
    succeeds(&command.args(["--decompose", "--shading-change", "--out"]).arg(&set).output().unwrap());
    succeeds(&pack(&set, &out, &["--flow", "npz16"]));
    let index = fs::read_to_string(out.join("index.jsonl")).unwrap();
    let first: Value = serde_json::from_str(index.lines().next().unwrap()).unwrap();
    assert!(
        ["head_flow.npz16", "expression_flow.npz16", "shading_change.png"]
            .iter()
            .all(|name| first["members"][name].is_object())
    );
    let errors = |dataset: String| {
        let mut command = crate::srflow();
        command.args([
            "eval",
            "--dataset",
            &dataset,
            "--method",
            "farneback",
            "--expression-error",
            "--json",
        ]);
        let report = json(&command.output().unwrap());
        let methods = report["methods"].as_array().unwrap().iter();
        methods.map(|method| method["expression_error"].clone()).collect::<Vec<Value>>()
    };
    let own = errors(format!("srflow:{}", set.display()));
    assert!(own[1]["ratio"].as_f64().is_some_and(|ratio| ratio > 0.0), "{own:?}");
    assert_eq!(errors(format!("wds:{}", out.display())), own);
}

#[test]
fn a_stopped_run_goes_on_to_the_same_bytes_whatever_the_threads() {
    let folder = tempfile::tempdir().unwrap();
    let [through, stopped] = ["through", "stopped"].map(|name| folder.path().join(name));
    let report = json(&pack(rendered(), &through, &[&SMALL[..], &["--threads", "1", "--json"]].concat()));
    assert_eq!((&report["tars"], &report["stopped"]), (&4.into(), &false.into()));
    let before = tree(&through);
    assert!(before.keys().all(|path| !path.to_string_lossy().contains(".index")), "{:?}", before.keys());

    let first = pack(rendered(), &stopped, &[&SMALL[..], &["--stop-after", "3"]].concat());
    assert_eq!(first.status.code(), Some(75), "{first:?}");
    let kept = stopped.join("train-000000.tar");
    let modified = || fs::metadata(&kept).unwrap().modified().unwrap();
    let at = modified();
    assert!(!stopped.join("index.jsonl").exists());
    // As a killed run leaves it.
    fs::write(stopped.join(".train-000001.tar.7-0.partial"), "half").unwrap();
    let report = json(&pack(rendered(), &stopped, &[&SMALL[..], &["--threads", "3", "--json"]].concat()));
    assert_eq!(report["packed"], 6, "{report}");
    assert_eq!(modified(), at, "a whole tar was written again");
    let after = tree(&stopped);
    assert_eq!(after.keys().collect::<Vec<_>>(), before.keys().collect::<Vec<_>>());
    for (path, bytes) in &before {
        assert!(after[path] == *bytes, "{}", path.display());
    }
    let again = json(&pack(rendered(), &stopped, &[&SMALL[..], &["--json"]].concat()));
    assert_eq!((&again["packed"], &again["bytes"]), (&0.into(), &report["bytes"]));
}

#[test]
fn every_file_is_hashed_and_every_pair_is_in_the_index() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    succeeds(&pack(rendered(), &out, &SMALL));
    let files = tree(&out);
    let text = |name: &str| String::from_utf8(files[Path::new(name)].clone()).unwrap();
    let hashed: Vec<String> =
        text("SHA256SUMS").lines().map(|line| line.split_once("  ").unwrap().1.to_owned()).collect();
    let names: Vec<String> = files
        .keys()
        .map(|path| path.to_str().unwrap().replace('\\', "/"))
        .filter(|name| name != "SHA256SUMS")
        .collect();
    assert_eq!(hashed, names);
    let index = text("index.jsonl");
    assert_eq!(index.lines().count(), 8);
    let first: Value = serde_json::from_str(index.lines().next().unwrap()).unwrap();
    assert_eq!(first["tar"], "train-000000.tar");
    let members: Vec<&String> = first["members"].as_object().unwrap().keys().collect();
    assert_eq!(
        members,
        [
            "alpha.png",
            "depth.png",
            "flow.npy",
            "flow_backward.npy",
            "frame1.png",
            "frame2.png",
            "mask.png",
            "meta.json",
            "occlusion.png",
            "regions.png"
        ]
    );
    let card = text("README.md");
    for said in [
        "configs:",
        "split: train\n    path: train-*.tar",
        "![scene-",
        "| `flow.npy` |",
        "| train | 1 | 4 | 2 |",
    ] {
        assert!(card.contains(said), "{said}: {card}");
    }
    serde_json::from_str::<Value>(&text("croissant.json")).unwrap();
}

#[test]
fn generic_pairs_are_packed_too() {
    let folder = tempfile::tempdir().unwrap();
    let [made, out] = ["made", "packed"].map(|name| folder.path().join(name));
    let mut command = crate::srflow();
    command.args(["shapes", "--size", "96x64", "--pairs", "3", "--out"]).arg(&made);
    succeeds(&command.output().unwrap());
    succeeds(&pack(&made, &out, &["--flow", "npz16"]));
    let own = scores(&format!("chairs:{}", made.display()), &["--split", "all"]);
    assert_eq!(scores(&format!("wds:{}", out.display()), &["--split", "all"]), own);
}

#[test]
fn mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    refuses(&pack(folder.path(), &out, &[]), 1, &["dataset.json or shapes.json", "found none"]);
    refuses(&pack(rendered(), rendered(), &[]), 2, &["--out", "expected another folder"]);
    refuses(&pack(rendered(), &out, &["--shard-size", "1kB"]), 2, &["--shard-size", "65536"]);
    refuses(&pack(rendered(), &out, &["--shard-size", "big"]), 2, &["a size such as 500MB"]);
    fs::create_dir_all(&out).unwrap();
    fs::write(out.join("thesis.tex"), "").unwrap();
    refuses(&pack(rendered(), &out, &["--force"]), 2, &["--out", "thesis.tex"]);
    fs::remove_file(out.join("thesis.tex")).unwrap();
    succeeds(&pack(rendered(), &out, &[]));
    refuses(&pack(rendered(), &out, &["--flow", "png"]), 1, &["other arguments", "--force"]);
    succeeds(&pack(rendered(), &out, &["--flow", "png", "--force"]));
    fs::remove_file(out.join("test-000000.tar")).unwrap();
    refuses(&pack(rendered(), &out, &["--flow", "png"]), 1, &["test-000000.tar: expected", "found 0"]);

    let data = format!("wds:{}", out.display());
    let eval = |dataset: &str, split: &str| {
        let mut command = crate::srflow();
        command
            .args(["eval", "--dataset", dataset, "--split", split, "--method", "farneback"])
            .output()
            .unwrap()
    };
    refuses(&eval(&data, "val"), 1, &["wds has no val split", "train (4 pairs), test (4 pairs)"]);
    refuses(&eval(&data, "test"), 1, &["test-000000.tar", "No such file"]);
    refuses(&eval(&format!("wds:{}", folder.path().display()), "all"), 1, &["*.tar", "packed"]);

    // Content that is not that of the index.
    let tar = out.join("train-000000.tar");
    let mut bytes = fs::read(&tar).unwrap();
    let name = b"scene-0000_00001.mask.png";
    let at = bytes.windows(name.len()).position(|part| part == name).expect("a member of the first scene");
    bytes[at + 512 + 40] ^= 1;
    fs::write(&tar, &bytes).unwrap();
    refuses(
        &eval(&data, "train"),
        1,
        &["train-000000.tar", "scene-0000_00001.mask.png with a SHA-256", "copy it again"],
    );
    fs::write(&tar, &bytes[..at]).unwrap();
    refuses(&eval(&data, "train"), 1, &["train-000000.tar: expected bytes", "copy it again"]);
}

#[test]
fn flow_beyond_float16_needs_another_format() {
    let folder = tempfile::tempdir().unwrap();
    let [made, out] = ["made", "packed"].map(|name| folder.path().join(name));
    let mut command = crate::srflow();
    command.args(["shapes", "--size", "96x64", "--pairs", "2", "--flow-format", "flo", "--out"]).arg(&made);
    succeeds(&command.output().unwrap());
    let far = made.join("data/00001_flow.flo");
    let mut flow = read_flow(&far).unwrap();
    flow.set(3, 2, [700.1, 0.0]);
    flow.set(4, 2, [f32::NAN; 2]);
    write_flow(&far, &flow).unwrap();
    let error = fails(&pack(&made, &out, &[]), 1);
    for said in [
        "00001_flow.flo: pixel (3, 2): expected components below 512",
        "found (700.1, 0)",
        "choose another --flow",
    ] {
        assert!(error.contains(said), "{said}: {error}");
    }
    let report = json(&pack(&made, &out, &["--flow", "npy32", "--force", "--json"]));
    assert_eq!(report["flow_error"], 0.0);
    let tar = fs::read(out.join("train-000000.tar")).unwrap();
    let name = b"00001.flow.npy";
    let at = 512 + tar.windows(name.len()).position(|part| part == name).unwrap();
    let npy = folder.path().join("flow.npy");
    fs::write(&npy, &tar[at..at + 128 + 96 * 64 * 8]).unwrap();
    let same = |a: &FlowField, b: &FlowField| {
        a.pixels()
            .iter()
            .zip(b.pixels())
            .all(|(a, b)| a.map(f32::to_bits) == b.map(f32::to_bits) || (a[0].is_nan() && b[0].is_nan()))
    };
    assert!(same(&read_flow(&npy).unwrap(), &flow));
}

/// Serves the files of a folder, with ranges; the requests with these numbers, from 0, fail. The number of requests so far follows.
fn serve(folder: PathBuf, fails: fn(usize) -> bool) -> (String, &'static AtomicUsize) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let requests: &'static AtomicUsize = Box::leak(Box::default());
    thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let folder = folder.clone();
            // A client that is not satisfied hangs up.
            thread::spawn(move || {
                _ = answer(stream, &folder, &|| fails(requests.fetch_add(1, Ordering::SeqCst)))
            });
        }
    });
    (address, requests)
}

fn answer(mut stream: TcpStream, folder: &Path, fails: &dyn Fn() -> bool) -> std::io::Result<()> {
    let mut lines = BufReader::new(stream.try_clone()?).lines();
    loop {
        let mut request = Vec::new();
        for line in lines.by_ref() {
            match line? {
                line if line.is_empty() => break,
                line => request.push(line),
            }
        }
        let Some(path) = request.first().and_then(|line| line.split(' ').nth(1)) else { return Ok(()) };
        let range = request.iter().find_map(|line| {
            let line = line.to_ascii_lowercase();
            let (first, last) = line.strip_prefix("range: bytes=")?.split_once('-')?;
            Some((first.parse::<u64>().ok()?, last.parse::<u64>().ok()?))
        });
        let (first, last) = range.expect("every request is for a range");
        if fails() {
            return write!(stream, "HTTP/1.1 500 Oh\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        }
        let Ok(mut file) = fs::File::open(folder.join(path.trim_start_matches('/'))) else {
            write!(stream, "HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n")?;
            continue;
        };
        let total = file.metadata()?.len();
        let last = last.min(total - 1);
        let mut bytes = vec![0; (last + 1 - first) as usize];
        file.seek(SeekFrom::Start(first))?;
        file.read_exact(&mut bytes)?;
        write!(
            stream,
            "HTTP/1.1 206 Partial Content\r\nContent-Range: bytes {first}-{last}/{total}\r\nContent-Length: {}\r\n\r\n",
            bytes.len()
        )?;
        stream.write_all(&bytes)?;
    }
}

#[test]
fn tars_are_read_from_a_server_by_one_request_for_each_pair() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    succeeds(&pack(rendered(), &out, &SMALL));
    let on_disk = scores(&format!("wds:{}", out.display()), &[]);
    let (address, requests) = serve(out.clone(), |_| false);
    assert_eq!(scores(&format!("wds:{address}"), &[]), on_disk);
    // The index, and four pairs: twice each where a command opens a dataset twice.
    let asked = requests.load(Ordering::SeqCst);
    assert!((5..=10).contains(&asked), "{asked} requests");
    // Every third request fails.
    let (address, _) = serve(out.clone(), |number| number % 3 == 1);
    assert_eq!(scores(&format!("wds:{address}/"), &[]), on_disk);
    // Without an index, by the headers.
    fs::remove_file(out.join("index.jsonl")).unwrap();
    assert_eq!(scores(&format!("wds:{address}/test-{{000000..000001}}.tar"), &[]), on_disk);
    let mut command = crate::srflow();
    command.args(["eval", "--method", "farneback", "--dataset", &format!("wds:{address}")]);
    refuses(&command.output().unwrap(), 1, &[&address, "index.jsonl", "404", "check the address"]);
}

#[test]
fn training_from_a_server_is_training_from_the_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    succeeds(&pack(rendered(), &out, &[&SMALL[..], &["--flow", "npz16"]].concat()));
    let (address, _) = serve(out, |number| number % 4 == 1);
    let losses = |data: &str, name: &str| {
        let run = folder.path().join(name);
        let mut command = crate::srflow();
        command.args(["train", "--network", "raft-small", "--data", data, "--out"]).arg(&run);
        command.args(["--crop", "64x64", "--batch", "1", "--iterations", "1", "--steps", "3"]);
        command.args(["--seed", "5", "--threads", "2"]);
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{output:?}");
        let log = fs::read_to_string(run.join("log.jsonl")).unwrap();
        let lines = log.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        lines.filter_map(|line| line.get("loss").cloned()).collect::<Vec<Value>>()
    };
    let own = losses(&format!("srflow:{}", rendered().display()), "own");
    assert!(!own.is_empty());
    assert_eq!(losses(&format!("wds:{address}"), "streamed"), own);
}

/// Tars that other programs made are read, and other programs read ours.
#[test]
fn python_and_gnu_tar_agree() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    succeeds(&pack(rendered(), &out, &[]));
    let expected = scores(&format!("wds:{}", out.display()), &["--split", "all"]);
    let unpacked = folder.path().join("unpacked");
    fs::create_dir(&unpacked).unwrap();
    let ready = Command::new("tar").arg("--version").output();
    if !ready.is_ok_and(|ready| String::from_utf8_lossy(&ready.stdout).contains("GNU tar")) {
        eprintln!("skipped: gnu-tar: tar on the PATH is another one");
        return;
    }
    for name in ["train-000000.tar", "test-000000.tar"] {
        let output =
            Command::new("tar").arg("-xf").arg(out.join(name)).arg("-C").arg(&unpacked).output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    }
    for format in ["gnu", "pax", "ustar", "v7", "oldgnu"] {
        let other = folder.path().join(format);
        fs::create_dir(&other).unwrap();
        let mut command = Command::new("tar");
        command.current_dir(&unpacked).arg(format!("--format={format}")).args(["--sort=name", "-cf"]);
        let output = command.arg(other.join("all.tar")).arg(".").output().unwrap();
        assert!(output.status.success(), "{output:?}");
        assert_eq!(
            scores(&format!("wds:{}", other.display()), &["--split", "all"])
                .into_values()
                .collect::<Vec<_>>(),
            expected.values().copied().collect::<Vec<_>>(),
            "{format}"
        );
    }
    let python = std::env::var("SRFLOW_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let script =
        "import sys, tarfile\nwith tarfile.open('all.tar', 'w') as tar: tar.add(sys.argv[1], arcname='.')";
    let other = folder.path().join("python");
    fs::create_dir(&other).unwrap();
    let output = Command::new(&python).current_dir(&other).args(["-c", script]).arg(&unpacked).output();
    if !output.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: python: {python} does not run; set SRFLOW_PYTHON");
        return;
    }
    assert_eq!(scores(&format!("wds:{}", other.display()), &["--split", "all"]).len(), expected.len());
}

/// Runs `tests/packed/read_packed.py`.
#[test]
fn other_programs_read_packed_datasets() {
    let python = std::env::var("SRFLOW_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let needed = "import datasets, mlcroissant, numpy, PIL, webdataset";
    let ready = Command::new(&python).args(["-c", needed]).output();
    if !ready.is_ok_and(|ready| ready.status.success()) {
        eprintln!(
            "skipped: webdataset: {python} lacks datasets, mlcroissant, numpy, pillow or webdataset; set SRFLOW_PYTHON"
        );
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("packed");
    succeeds(&pack(rendered(), &out, &SMALL));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/packed/read_packed.py");
    for split in ["train", "test"] {
        let mut command = Command::new(&python);
        command.env("PYTHONDONTWRITEBYTECODE", "1").env("HF_HOME", folder.path().join("cache"));
        command.env("CROISSANT_CACHE", folder.path().join("croissant")).env("HF_HUB_OFFLINE", "1");
        let output = command.arg(&script).arg(&out).arg(split).output().unwrap();
        let printed = String::from_utf8_lossy(&output.stdout);
        assert!(printed.contains("4 samples read"), "{printed}\n{}", String::from_utf8_lossy(&output.stderr));
    }
}
