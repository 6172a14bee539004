//! `srflow train` as one of several processes.

use srflow_core::Size;

use crate::frames::write_pairs;

/// Arguments of a run on batches of three.
fn arguments<'a>(data: &'a str, out: &'a str, steps: &'a str) -> Vec<&'a str> {
    let mut arguments = vec!["train", "--data", data, "--out", out, "--network", "raft-small"];
    arguments.extend([
        "--crop",
        "64x64",
        "--batch",
        "3",
        "--iterations",
        "2",
        "--steps",
        steps,
        "--threads",
        "1",
    ]);
    arguments.extend(["--set", "checkpoints.every=2", "--set", "checkpoints.keep=20"]);
    arguments
}

#[cfg(not(feature = "mpi"))]
#[test]
fn a_build_without_mpi_says_so() {
    use crate::refuses;

    let dir = tempfile::tempdir().unwrap();
    write_pairs(dir.path(), 3, Size::new(80, 80), 2.0);
    let data = format!("folder:{}", dir.path().display());
    let out = dir.path().join("run");
    let output =
        crate::srflow().args(arguments(&data, out.to_str().unwrap(), "6")).arg("--mpi").output().unwrap();
    refuses(&output, 2, &["--features mpi", "docs/guides/train.md"]);
    assert!(!out.exists());
}

#[cfg(feature = "mpi")]
mod mpi {
    use std::path::{Path, PathBuf};
    use std::process::{Command, Output, Stdio};
    use std::time::Duration;

    use super::*;

    fn mpirun(processes: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new("mpirun");
        command.args(["-n", processes]).arg(crate::binary()).args(arguments).arg("--mpi");
        // Tests run with more processes than cores, and in containers as root.
        command.envs(
            ["OMPI_MCA_rmaps_base_oversubscribe", "OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"]
                .map(|name| (name, "1")),
        );
        command
    }

    fn weights(run: &Path, step: u64) -> [Vec<u8>; 2] {
        let checkpoint = run.join(format!("checkpoints/step-{step:08}"));
        ["model.safetensors", "optimizer.safetensors"]
            .map(|name| std::fs::read(checkpoint.join(name)).unwrap())
    }

    fn text(bytes: &[u8]) -> String {
        String::from_utf8_lossy(bytes).into_owned()
    }

    #[track_caller]
    fn ends(output: &Output, code: i32) -> String {
        assert_eq!(output.status.code(), Some(code), "{}{}", text(&output.stdout), text(&output.stderr));
        text(&output.stderr)
    }

    struct Folders {
        _dir: tempfile::TempDir,
        data: String,
        one: PathBuf,
        many: PathBuf,
    }

    fn folders() -> Folders {
        let dir = tempfile::tempdir().unwrap();
        write_pairs(dir.path(), 7, Size::new(80, 80), 2.0);
        let data = format!("folder:{}", dir.path().display());
        let [one, many] = ["one", "many"].map(|name| dir.path().join(name));
        Folders { _dir: dir, data, one, many }
    }

    #[test]
    fn processes_give_the_bits_of_parts_accumulated_in_one() {
        let Folders { data, one, many, .. } = &folders();
        let mut alone = arguments(data, one.to_str().unwrap(), "6");
        alone.extend(["--set", "training.accumulate=3"]);
        ends(&crate::srflow().args(alone).output().unwrap(), 0);
        let together = mpirun("3", &arguments(data, many.to_str().unwrap(), "6")).output().unwrap();
        ends(&together, 0);
        for step in [2, 4, 6] {
            assert!(weights(one, step) == weights(many, step), "step {step}");
        }
        assert!(many.join("report.html").exists());
        let said = text(&together.stdout);
        assert!(said.contains("Ranks             3\n") && said.matches("6 steps").count() == 1, "{said}");
    }

    #[test]
    fn processes_that_are_stopped_or_killed_are_resumed_by_others() {
        let Folders { data, one, many, .. } = &folders();
        let out = many.to_str().unwrap();
        let mut stopping = arguments(data, out, "6");
        stopping.extend(["--stop-after-step", "3"]);
        ends(&mpirun("3", &stopping).output().unwrap(), 75);
        ends(&mpirun("3", &["train", "--resume", out, "--threads", "1"]).output().unwrap(), 0);
        ends(&mpirun("3", &arguments(data, one.to_str().unwrap(), "6")).output().unwrap(), 0);
        assert!(weights(one, 6) == weights(many, 6));

        // One of a long run is killed.
        let lost = one.with_file_name("lost");
        let lost = lost.to_str().unwrap();
        let mut run = mpirun("3", &arguments(data, lost, "100000"));
        let run = run.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let second = Path::new(lost).join("checkpoints/step-00000002");
        for _ in 0..600 {
            if second.exists() {
                break;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        assert!(second.exists(), "a checkpoint within a minute");
        let ranks = Command::new("pgrep").args(["-f", &format!("train .*--out {lost}")]).output().unwrap();
        // mpirun has the same arguments, and is the oldest.
        let victim = text(&ranks.stdout).lines().last().unwrap().to_owned();
        assert!(Command::new("kill").args(["-9", &victim]).status().unwrap().success());
        let output = run.wait_with_output().unwrap();
        assert_ne!(output.status.code(), Some(0));
        let said = text(&output.stderr);
        assert!(said.to_lowercase().contains("signal 9"), "{said}");
        let checkpoints = std::fs::read_dir(Path::new(lost).join("checkpoints")).unwrap();
        let names = checkpoints.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let steps = names.filter_map(|name| name.strip_prefix("step-")?.parse::<u64>().ok());
        let stop = (steps.max().unwrap() + 1).to_string();
        let resume = ["train", "--resume", lost, "--threads", "1", "--stop-after-step", &stop];
        let output = mpirun("2", &resume).output().unwrap();
        let said = ends(&output, 75);
        assert!(said.contains("the number of ranks was 3 before"), "{said}");
    }

    #[test]
    fn a_process_that_fails_says_so_once_and_ends_all() {
        let Folders { data, many, .. } = &folders();
        let broken = Path::new(data.strip_prefix("folder:").unwrap()).join("p4_img2.png");
        assert!(broken.exists());
        std::fs::write(&broken, "no picture").unwrap();
        let said = ends(&mpirun("3", &arguments(data, many.to_str().unwrap(), "6")).output().unwrap(), 1);
        assert!(said.contains("of 3, counted from 0: ") && said.contains("p4_img2.png"), "{said}");
        assert_eq!(said.matches("error: ").count(), 1, "{said}");
    }
}
