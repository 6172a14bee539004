//! `srflow avatar train`: a small made-up capture, a kill, a resume, and mistakes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use serde_json::Value;
use srflow_core::{Image, Size};
use srflow_files::{read_image, write_image_png};

use crate::{refuses, succeeds};

/// A folder with the folder `capture`: four timesteps of the built-in head by four cameras, of which the last camera and the last
/// timestep are held out.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let dir = crate::binary().with_file_name("avatar-training-of-tests");
        let _ = fs::remove_dir_all(&dir); // of an earlier test run
        fs::create_dir(&dir).unwrap();
        let made = crate::srflow()
            .current_dir(&dir)
            .args(["avatar", "capture", "--cameras", "4", "--timesteps", "4", "--size", "69x100"])
            .args(["--seed", "4", "--out", "capture"])
            .output();
        succeeds(&made.unwrap());
        dir
    })
}

fn command(arguments: &[&str]) -> Command {
    let mut command = crate::srflow();
    command.current_dir(folder()).args(["avatar", "train"]).args(arguments);
    command
}

fn train(arguments: &[&str]) -> Output {
    command(arguments).output().expect("srflow runs")
}

/// Everything of a long training in a few iterations.
const SHORT: [&str; 22] = [
    "--config",
    "cpu",
    "--set",
    "sh_interval=20",
    "--set",
    "rates.position_steps=80",
    "--set",
    "rates.sh_0=0.02",
    "--set",
    "density.from=10",
    "--set",
    "density.until=60",
    "--set",
    "density.interval=20",
    "--set",
    "density.reset_interval=1000",
    "--set",
    "density.reset_opacity=1",
    "--set",
    "density.gradient_threshold=0.0001",
    "--threads",
    "2",
];

fn short<'a>(out: &'a str, iterations: &'a str) -> Vec<&'a str> {
    [&["capture", "--out", out, "--iterations", iterations][..], &SHORT].concat()
}

#[track_caller]
fn finishes(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// A run that fails while it trains, with these parts in its error.
#[track_caller]
fn stops(output: &Output, parts: &[&str]) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let error = said.lines().find(|line| line.starts_with("error: ")).unwrap_or_default();
    assert!(!said.contains("panicked") && parts.iter().all(|part| error.contains(part)), "{said}");
}

fn log(run: &Path) -> Vec<Value> {
    let text = fs::read_to_string(run.join("log.jsonl")).unwrap_or_default();
    text.lines().map_while(|line| serde_json::from_str(line).ok()).collect()
}

/// The lines of a log without the time they took, and without their sums.
fn timeless(run: &Path) -> Vec<Value> {
    let mut log = log(run);
    for record in &mut log {
        record.as_object_mut().unwrap().retain(|name, _| name != "seconds" && name != "crc32");
    }
    log
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() { files.extend(files_below(&entry)) } else { files.push(entry) }
    }
    files.sort();
    files
}

#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    const ITERATIONS: &str = "80";
    let dir = tempfile::tempdir().unwrap();
    let [through, killed] = ["through", "killed"].map(|name| dir.path().join(name));
    let [through_text, killed_text] = [&through, &killed].map(|run| run.to_str().unwrap());
    finishes(&train(&short(through_text, ITERATIONS)));

    let stopped = train(&[&short(killed_text, ITERATIONS)[..], &["--stop-after", "13"]].concat());
    assert_eq!(stopped.status.code(), Some(75), "{}", String::from_utf8_lossy(&stopped.stderr));
    assert!(String::from_utf8_lossy(&stopped.stdout).contains("--resume"));
    assert!(killed.join("preview.png").exists() && !killed.join("scores.json").exists());
    // The log is ahead of the checkpoint of iteration 13 when the run is killed, which writes no other.
    let mut going = command(&["--resume", killed_text, "--checkpoint-every", "1000"]);
    let mut going = going.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let began = Instant::now();
    while log(&killed).len() < 30 {
        assert!(going.try_wait().unwrap().is_none() && began.elapsed() < Duration::from_secs(120));
        std::thread::sleep(Duration::from_millis(5));
    }
    going.kill().unwrap();
    going.wait().unwrap();
    assert!(!killed.join("scores.json").exists(), "it was killed too late");
    fs::write(killed.join(".checkpoint.npz.1-1.partial"), "half").unwrap();
    fs::write(killed.join("point_cloud/iteration_20/.point_cloud.ply.1-2.partial"), "half").unwrap();
    let resumed = train(&["--resume", killed_text, "--threads", "1"]);
    finishes(&resumed);
    assert!(String::from_utf8_lossy(&resumed.stderr).contains("from iteration 13"));

    let [expected, found] = [&through, &killed].map(|run| timeless(run));
    assert_eq!(found, expected);
    assert!(expected.iter().any(|record| record["kind"] == "scores"));
    let names = |run: &Path| -> Vec<PathBuf> {
        files_below(run).iter().map(|file| file.strip_prefix(run).unwrap().to_owned()).collect()
    };
    assert_eq!(names(&killed), names(&through));
    let avatars = files_below(&through.join("point_cloud"));
    assert_eq!(avatars.len(), 10 * 3, "Gaussians, parameters and head, ten times");
    let others = ["scores.json", "config.toml", "run.json", "checkpoint.npz", "preview.png"];
    for file in avatars.into_iter().chain(others.map(|name| through.join(name))) {
        let name = file.strip_prefix(&through).unwrap();
        let same = fs::read(&file).unwrap() == fs::read(killed.join(name)).unwrap();
        assert!(same, "{}", name.display());
    }

    // Again: a finished run is scored and reported, not trained.
    finishes(&train(&["--resume", killed_text]));
    assert_eq!(timeless(&killed), expected);
    refuses(&train(&short(killed_text, ITERATIONS)), 1, &["already contains a run", "--resume"]);
    refuses(&train(&["--resume", killed_text, "--iterations", "90"]), 2, &["cannot be used with"]);
}

#[test]
fn a_trained_avatar_is_scored_shown_and_opened() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let run_text = run.to_str().unwrap();
    let output = train(&[&short(run_text, "120")[..], &["--json", "--strategy", "absgs"]].concat());
    let report: Value = serde_json::from_str(&finishes(&output)).unwrap();
    let [val, test] = [0, 1].map(|place| &report["scores"][place]);
    assert_eq!((&val["split"], &val["pictures"]), (&"val".into(), &3.into()));
    assert_eq!((&test["split"], &test["pictures"]), (&"test".into(), &4.into()));
    let ratio = |scores: &Value, name: &str| scores[name].as_f64().unwrap();
    assert!(ratio(val, "psnr") > 15.0 && ratio(val, "psnr_channels") >= ratio(val, "psnr"), "{val}");
    assert!(ratio(val, "ssim") > 0.75, "{val}");
    let scores: Value = serde_json::from_slice(&fs::read(run.join("scores.json")).unwrap()).unwrap();
    assert_eq!(scores["splits"][1]["views"].as_array().unwrap().len(), 4);
    assert_eq!(scores["splits"][1]["psnr"], test["psnr"]);

    let page = fs::read_to_string(run.join("report.html")).unwrap();
    assert_eq!(page.matches("type=\"range\"").count(), 6, "worst, median and best of two splits");
    assert!(!page.contains("src=\"http") && !page.contains("<link"), "it loads nothing");
    for text in ["Held-out camera", "Held-out timesteps", "density.strategy", "&quot;absgs&quot;"] {
        assert!(page.contains(text), "{text}");
    }
    let preview = read_image(&run.join("preview.png")).unwrap();
    assert_eq!(preview.size(), Size::new(2 * 69, 100));
    // Truth on the left, the rendering, which is near it, on the right.
    let difference = |(x, y): (usize, usize)| {
        let (a, b) = (preview.get(x, y), preview.get(x + 69, y));
        a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(b))).sum::<f64>() / 3.0
    };
    let pixels = (0..100).flat_map(|y| (0..69).map(move |x| (x, y)));
    let mean = pixels.map(difference).sum::<f64>() / 6900.0;
    assert!((0.1..25.0).contains(&mean), "{mean}");

    let seen = crate::srflow()
        .current_dir(folder())
        .args([
            "rasterize",
            "--head",
            &format!("avatar:{run_text}"),
            "--timestep",
            "1",
            "--timestep-next",
            "2",
        ])
        .args(["--camera", "capture/transforms.json", "--view", "00001_08", "--out"])
        .arg(dir.path().join("seen"))
        .output();
    succeeds(&seen.unwrap());

    let page = dir.path().join("run.html");
    let viewed = crate::srflow().current_dir(folder()).args(["view", run_text, "-o"]).arg(&page).output();
    succeeds(&viewed.unwrap());
    assert!(page.exists());
}

#[test]
fn configurations_are_printed_and_their_mistakes_named() {
    let printed = train(&["--preset", "cpu", "--faithful", "--set", "background=[0,0,0]", "--print-config"]);
    let text = succeeds(&printed);
    for line in
        ["iterations = 10000", "faithful = true", "background = [0.0, 0.0, 0.0]", "position_steps = 10000"]
    {
        assert!(text.contains(line), "{line} in {text}");
    }
    // The output is a configuration.
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mine.toml");
    fs::write(&file, &text).unwrap();
    let file = file.to_str().unwrap();
    assert_eq!(succeeds(&train(&["--config", file, "--print-config"])), text);
    let default: Value = serde_json::from_str(&succeeds(&train(&["--print-config", "--json"]))).unwrap();
    assert_eq!(default["iterations"], 600_000);

    let print = |arguments: [&str; 2]| train(&[&arguments[..], &["--print-config"]].concat());
    refuses(&print(["--config", "gpu"]), 1, &["gpu", "gaussian-avatars, cpu"]);
    refuses(&print(["--set", "density.stop=4"]), 1, &["`stop`", "`until`"]);
    refuses(&print(["--strategy", "random"]), 1, &["`random`", "`absgs`"]);
    refuses(&print(["--iterations", "0"]), 1, &["iterations"]);
    refuses(&print(["--set", "seed=x"]), 1, &["seed=x", "a whole number from 0"]);
    refuses(&print(["--seed", "x"]), 2, &["--seed"]);
    fs::write(file, "iterations = 5\nitertions = 6\n").unwrap();
    refuses(&print(["--config", file]), 1, &["mine.toml", "line 2", "`itertions`"]);
    refuses(&train(&[]), 2, &["DATA", "--out"]);
    refuses(&train(&["capture"]), 2, &["--out"]);
    refuses(&train(&["capture", "--out", "never", "--checkpoint-every=-1"]), 2, &["--checkpoint-every"]);
}

#[test]
fn mistakes_in_folders_say_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let place = |name: &str| dir.path().join(name).display().to_string();
    let out = place("run");
    let with = |data: &str| train(&[&[data, "--out", &out, "--iterations", "3"][..], &SHORT].concat());
    refuses(&with("nowhere"), 1, &["nowhere", "transforms_train.json"]);
    refuses(&train(&["capture", "--out", "a.json"]), 2, &["a.json", "a folder"]);
    refuses(&train(&["capture", "--out", "capture"]), 1, &["empty folder", "--out"]);
    refuses(&train(&["--resume", "capture"]), 1, &["capture", "run.json"]);

    let data = dir.path().join("data");
    for file in files_below(&folder().join("capture")) {
        let copy = data.join(file.strip_prefix(folder().join("capture")).unwrap());
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        fs::copy(&file, copy).unwrap();
    }
    let data_text = data.display().to_string();
    fs::remove_file(data.join("head.json")).unwrap();
    refuses(&with(&data_text), 2, &["no head.json", "--model"]);
    let other = train(&["capture", "--out", &out, "--model", "builtin-average"]);
    refuses(&other, 2, &["builtin-average", "builtin of seed 4", "leave out --model"]);
    assert!(!Path::new(&out).exists(), "no run was begun");
    fs::copy(folder().join("capture/head.json"), data.join("head.json")).unwrap();

    // The run is stopped by the first picture that is missing or of another size, and goes on with it.
    let images = files_below(&data.join("images"));
    let whole: Vec<Vec<u8>> = images.iter().map(|image| fs::read(image).unwrap()).collect();
    images.iter().for_each(|image| write_image_png(image, &Image::new(10, 10)).unwrap());
    stops(&with(&data_text), &["images", "69x100", "10x10"]);
    images.iter().for_each(|image| fs::remove_file(image).unwrap());
    stops(&train(&["--resume", &out]), &["images", ".png"]);
    images.iter().zip(&whole).for_each(|(image, bytes)| fs::write(image, bytes).unwrap());
    finishes(&train(&["--resume", &out]));

    let checkpoint = dir.path().join("run/checkpoint.npz");
    let bytes = fs::read(&checkpoint).unwrap();
    fs::write(&checkpoint, &bytes[..bytes.len() / 2]).unwrap();
    refuses(&train(&["--resume", &out]), 1, &["checkpoint.npz"]);
    fs::write(&checkpoint, &bytes).unwrap();
    let config = dir.path().join("run/config.toml");
    let text = fs::read_to_string(&config).unwrap();
    fs::write(&config, text.replace("iterations = 3", "iterations = 4")).unwrap();
    refuses(&train(&["--resume", &out]), 1, &["checkpoint.npz", "iterations"]);
    fs::write(&config, &text).unwrap();
    // A capture that has moved is named again.
    fs::rename(&data, dir.path().join("moved")).unwrap();
    refuses(&train(&["--resume", &out]), 1, &["data"]);
    finishes(&train(&[&place("moved"), "--resume", &out]));

    let lock = fs::File::options().write(true).open(dir.path().join("run/.lock")).unwrap();
    lock.lock().unwrap();
    refuses(&train(&[&place("moved"), "--resume", &out]), 1, &["another process", "another folder"]);
}
