//! Checkpoints of a run, from which it resumes exactly.
//!
//! A checkpoint is a folder `step-NNNNNNNN` with four files: `model.safetensors`, the parameters under the names of the
//! reference implementation; `optimizer.safetensors`, the state of AdamW; `state.json`, progress and configuration; `SHA256SUMS`,
//! the hashes of the three. The folder is written under a temporary name and renamed when complete. No random state needs saving:
//! every random number derives from the seed, the step and the place in the batch.

use std::fs;
use std::path::{Path, PathBuf};

use burn::tensor::DType;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use srflow_files::{
    FileError, FileKind, FileProblem, PARTIAL_EXTENSION, SHA256SUMS, create_folder, hexadecimal,
    parse_error_in_words, parse_sha256sums_line, read_file, read_text, remove_partial, sha256_of_file,
    sha256sums_line, write_file,
};
use srflow_nn::{About, AdamWState, Layout, StoredAs, WeightsError, read_safetensors, safetensors_bytes};

/// Name of the folder of checkpoints in a run's folder.
const FOLDER: &str = "checkpoints";
const MODEL: &str = "model.safetensors";
const OPTIMIZER: &str = "optimizer.safetensors";
const STATE: &str = "state.json";
/// Prefix of the folders of unfinished checkpoints.
const UNFINISHED: &str = ".step-";
/// Prefixes of the tensors of AdamW's two averages.
const AVERAGES: [&str; 2] = ["mean.", "square."];

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// Steps done, including skipped ones.
    pub step: u64,
    /// Complete epochs.
    pub epoch: u64,
    /// Steps skipped because the loss or the gradients were not finite.
    pub skipped: u64,
    /// Consecutive skipped steps up to now.
    pub skipped_in_a_row: u64,
    /// Updates of the parameters.
    pub optimizer_steps: u64,
    /// The best validation so far.
    pub best: Option<Best>,
}

/// The step with the smallest end-point error on the first validation set.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Best {
    pub step: u64,
    /// Mean end-point error in pixels.
    pub epe: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    pub progress: Progress,
    /// The run's configuration as TOML.
    pub config: String,
    /// Parameters and running statistics of the network, in the order of its [`Layout`].
    pub values: Vec<f32>,
    pub optimizer: AdamWState,
    /// Processes that trained together.
    pub ranks: usize,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StateFile {
    progress: Progress,
    config: String,
    #[serde(default = "alone", skip_serializing_if = "is_alone")]
    ranks: usize,
}

fn alone() -> usize {
    1
}

fn is_alone(ranks: &usize) -> bool {
    *ranks == 1
}

/// Errors of reading and writing checkpoints.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error(
        "{}: {reason}; {}", .path.display(),
        .before.as_ref().map_or("start the run again in another folder".to_owned(), |before| {
            format!("delete this checkpoint's folder to continue from {}", before.display())
        })
    )]
    Broken {
        path: PathBuf,
        reason: String,
        /// The checkpoint before.
        before: Option<PathBuf>,
    },
    #[error(
        "{}: found no checkpoint to continue from; start the run without `resume`", .folder.display()
    )]
    None { folder: PathBuf },
}

pub struct Checkpoints {
    run: PathBuf,
    folder: PathBuf,
    about: Option<About>,
}

impl Checkpoints {
    /// The checkpoints of the run in the folder `run`, which need not exist yet.
    pub fn of_run(run: &Path) -> Self {
        Self { run: run.to_owned(), folder: run.join(FOLDER), about: None }
    }

    /// Sets the metadata of the network that is written with its weights.
    pub fn about(self, about: About) -> Self {
        Self { about: Some(about), ..self }
    }

    /// Steps with a checkpoint, ascending.
    ///
    /// # Errors
    /// When the folder exists but cannot be listed.
    pub fn steps(&self) -> Result<Vec<u64>, CheckpointError> {
        if !self.folder.is_dir() {
            return Ok(Vec::new());
        }
        let mut steps = Vec::new();
        for name in names(&self.folder)? {
            steps.extend(name.strip_prefix("step-").and_then(|number| number.parse::<u64>().ok()));
        }
        steps.sort_unstable();
        Ok(steps)
    }

    /// The folder of the checkpoint of `step`.
    pub fn path(&self, step: u64) -> PathBuf {
        self.folder.join(format!("step-{step:08}"))
    }

    /// Writes a checkpoint, replacing one of the same step, and its parameters to `last.safetensors` in the run's folder.
    ///
    /// # Errors
    /// When a file cannot be written; existing files are then left unchanged, and no partial ones remain.
    pub fn write(&self, checkpoint: &Checkpoint, layout: &Layout) -> Result<(), CheckpointError> {
        let Checkpoint { progress, config, values, optimizer, ranks } = checkpoint;
        let model = self.model_bytes(layout, values);
        let state = StateFile { progress: progress.clone(), config: config.clone(), ranks: *ranks };
        let state = serde_json::to_string_pretty(&state).expect("plain numbers and text") + "\n";
        let averages = AVERAGES.into_iter().zip([&optimizer.mean, &optimizer.square]);
        let optimizer = averages.flat_map(|(prefix, values)| {
            let trained = layout.segments().iter().filter(|segment| segment.trained);
            trained.map(move |segment| {
                (
                    format!("{prefix}{}", segment.name),
                    segment.shape.as_slice(),
                    &values[segment.range.clone()],
                )
            })
        });
        let optimizer = safetensors_bytes(optimizer, StoredAs::F32, None);
        let files = [(MODEL, &model), (OPTIMIZER, &optimizer), (STATE, &state.into_bytes())];
        let line =
            |(name, bytes): &(&str, &Vec<u8>)| sha256sums_line(&hexadecimal(Sha256::digest(bytes)), name);
        let hashes = files.iter().map(line).collect::<String>().into_bytes();
        let files = [&files[..], &[(SHA256SUMS, &hashes)]].concat();
        let partial = self.folder.join(format!("{UNFINISHED}{:08}.{PARTIAL_EXTENSION}", progress.step));
        let written = self.write_folder(&partial, &self.path(progress.step), &files);
        if written.is_err() {
            let _ = fs::remove_dir_all(&partial); // the first error is the one to report
        }
        written?;
        self.write_model("last", &model)
    }

    /// Writes files into the folder `partial`, then renames it to `path`.
    fn write_folder(&self, partial: &Path, path: &Path, files: &[(&str, &Vec<u8>)]) -> Result<(), FileError> {
        remove_folder(partial)?;
        create_folder(partial)?;
        for (name, bytes) in files {
            write_file(&partial.join(name), bytes)?;
        }
        remove_folder(path)?;
        let failed =
            |error| FileProblem::Io { doing: "renaming the finished checkpoint", error }.in_file(path);
        fs::rename(partial, path).map_err(failed)
    }

    /// Writes `best.safetensors` into the run's folder.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_best(&self, layout: &Layout, values: &[f32]) -> Result<(), CheckpointError> {
        self.write_model("best", &self.model_bytes(layout, values))
    }

    fn write_model(&self, name: &str, bytes: &[u8]) -> Result<(), CheckpointError> {
        let path = self.run.join(name).with_extension("safetensors");
        Ok(write_file(&path, bytes)?)
    }

    /// Deletes all checkpoints but the last `keep` and that of step `best`, then [unfinished files](Self::remove_unfinished).
    ///
    /// # Errors
    /// When a file or folder cannot be removed.
    pub fn prune(&self, keep: usize, best: Option<u64>) -> Result<(), CheckpointError> {
        let steps = self.steps()?;
        for &step in steps.iter().rev().skip(keep).filter(|&&step| Some(step) != best) {
            remove_folder(&self.path(step))?;
        }
        self.remove_unfinished()
    }

    /// Deletes the partial files and checkpoints that a killed run left behind. No other process may write into the run's folder
    /// at the same time.
    ///
    /// # Errors
    /// When a file or folder cannot be removed.
    pub fn remove_unfinished(&self) -> Result<(), CheckpointError> {
        for folder in [&self.run, &self.folder].into_iter().filter(|folder| folder.is_dir()) {
            remove_partial(folder, |_, _| true)?;
        }
        Ok(())
    }

    /// Reads the last checkpoint of the run.
    ///
    /// # Errors
    /// When there is none, it is broken or differs from what was written, or its tensors do not match `layout`.
    pub fn read_last(&self, layout: &Layout) -> Result<Checkpoint, CheckpointError> {
        self.with_last(|path| {
            let StateFile { progress, config, ranks } = read_state(path)?;
            let values = read_tensors(&path.join(MODEL), layout, "", |_| true)?;
            let [mean, square] = AVERAGES.map(|prefix| {
                read_tensors(&path.join(OPTIMIZER), layout, prefix, |name| name.starts_with(prefix))
            });
            let optimizer = AdamWState { steps: progress.optimizer_steps, mean: mean?, square: square? };
            Ok(Checkpoint { progress, config, values, optimizer, ranks })
        })
    }

    fn model_bytes(&self, layout: &Layout, values: &[f32]) -> Vec<u8> {
        let tensors = layout
            .segments()
            .iter()
            .map(|segment| (segment.name.clone(), segment.shape.as_slice(), &values[segment.range.clone()]));
        safetensors_bytes(tensors, StoredAs::F32, self.about.as_ref())
    }

    /// Reads the configuration of the run, as TOML, from its last checkpoint.
    ///
    /// # Errors
    /// When there is no checkpoint, or it is broken or differs from what was written.
    pub fn read_config(&self) -> Result<String, CheckpointError> {
        self.with_last(|path| Ok(read_state(path)?.config))
    }

    /// Applies `read` to the verified folder of the last checkpoint.
    fn with_last<T>(
        &self,
        read: impl FnOnce(&Path) -> Result<T, CheckpointError>,
    ) -> Result<T, CheckpointError> {
        let steps = self.steps()?;
        let Some((last, earlier)) = steps.split_last() else {
            return Err(CheckpointError::None { folder: self.folder.clone() });
        };
        let path = self.path(*last);
        verify(&path).and_then(|()| read(&path)).map_err(|error| match error {
            CheckpointError::Broken { path, reason, .. } => {
                let before = earlier.last().map(|step| self.path(*step));
                CheckpointError::Broken { path, reason, before }
            }
            other => other,
        })
    }
}

fn broken(path: &Path, reason: String) -> CheckpointError {
    CheckpointError::Broken { path: path.to_owned(), reason, before: None }
}

/// Compares the files of a checkpoint with their hashes.
fn verify(checkpoint: &Path) -> Result<(), CheckpointError> {
    let path = checkpoint.join(SHA256SUMS);
    if !path.exists() {
        log::warn!(
            "{}: an earlier version wrote this checkpoint, without hashes to verify it by",
            checkpoint.display()
        );
        return Ok(());
    }
    let text = read_file(&path, FileKind::Checkpoint)?;
    let text = String::from_utf8_lossy(&text);
    let hashes: Option<Vec<_>> = text.lines().map(parse_sha256sums_line).collect();
    let hashes = hashes.ok_or_else(|| broken(&path, "expected the hashes of files".to_owned()))?;
    for name in [MODEL, OPTIMIZER, STATE] {
        let Some((written, _)) = hashes.iter().find(|(_, of)| *of == Path::new(name)) else {
            return Err(broken(&path, format!("expected the hash of {name}, found none")));
        };
        let path = checkpoint.join(name);
        let now = hexadecimal(sha256_of_file(&path, FileKind::Checkpoint)?);
        if now != *written {
            let reason = format!("the file has changed since it was written (SHA-256 {now}, then {written})");
            return Err(broken(&path, reason));
        }
    }
    Ok(())
}

fn names(folder: &Path) -> Result<Vec<String>, FileError> {
    let failed = |error| FileProblem::Io { doing: "listing the folder", error }.in_file(folder);
    let entries = fs::read_dir(folder).map_err(failed)?;
    entries.map(|entry| Ok(entry.map_err(failed)?.file_name().to_string_lossy().into_owned())).collect()
}

fn remove_folder(path: &Path) -> Result<(), FileError> {
    let failed = |error| FileProblem::Io { doing: "removing the folder", error }.in_file(path);
    if path.exists() { fs::remove_dir_all(path).map_err(failed) } else { Ok(()) }
}

fn read_state(checkpoint: &Path) -> Result<StateFile, CheckpointError> {
    let path = checkpoint.join(STATE);
    let text = read_text(&path, FileKind::Json)?;
    serde_json::from_str(&text).map_err(|error| {
        broken(&path, format!("expected the state of a run ({})", parse_error_in_words(&error)))
    })
}

/// Reads the tensors whose names are `prefix` plus a name of the layout. With a prefix, tensors that are not trained may be
/// missing, as the optimizer has no state for them.
fn read_tensors(
    path: &Path,
    layout: &Layout,
    prefix: &str,
    counts: impl Fn(&str) -> bool,
) -> Result<Vec<f32>, CheckpointError> {
    let broken = |reason: String| broken(path, reason);
    let mut found = read_safetensors(path).map_err(|error| match error {
        WeightsError::File(error) => error.into(),
        WeightsError::Read { error, .. } => FileProblem::reading(error).in_file(path).into(),
        WeightsError::Broken { problem, .. } => {
            broken(format!("expected a whole safetensors file, but {problem}"))
        }
        other => broken(other.to_string()),
    })?;
    found.retain(|name, _| counts(name));
    let mut values = vec![0.0; layout.len()];
    for segment in layout.segments() {
        let name = format!("{prefix}{}", segment.name);
        let Some(data) = found.remove(&name) else {
            if segment.trained || prefix.is_empty() {
                return Err(broken(format!("expected a tensor {name}, found none")));
            }
            continue;
        };
        if data.dtype() != DType::F32 || data.shape().as_slice() != segment.shape {
            let found = format!("{:?} {:?}", data.dtype(), data.shape().as_slice());
            return Err(broken(format!("{name}: expected F32 {:?}, found {found}", segment.shape)));
        }
        let data = data.as_slice::<f32>().map_err(|error| broken(format!("{name}: {error:?}")))?;
        values[segment.range.clone()].copy_from_slice(data);
    }
    match found.keys().next() {
        Some(name) => Err(broken(format!("found the tensor {name:?}, which the network does not have"))),
        None => Ok(values),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_nn::Segment;

    fn layout() -> Layout {
        let segment = |name: &str, range: std::ops::Range<usize>, trained| Segment {
            name: name.to_owned(),
            shape: vec![range.len()],
            range,
            trained,
        };
        Layout::from_segments(vec![
            segment("a.weight", 0..4, true),
            segment("a.running_mean", 4..6, false),
            segment("b.bias", 6..7, true),
        ])
    }

    fn checkpoint(step: u64) -> Checkpoint {
        let values: Vec<f32> = (0..7).map(|i| i as f32 + step as f32).collect();
        let average = |scale: f32| {
            let of = |(i, value): (usize, &f32)| if (4..6).contains(&i) { 0.0 } else { scale * value };
            values.iter().enumerate().map(of).collect()
        };
        let optimizer = AdamWState { steps: step, mean: average(0.1), square: average(0.01) };
        let progress = Progress {
            step,
            epoch: 0,
            skipped: 0,
            skipped_in_a_row: 0,
            optimizer_steps: step,
            best: Some(Best { step: 2, epe: 0.1 + 0.2 }),
        };
        Checkpoint {
            progress,
            config: "[training]\nseed = 3\n".to_owned(),
            values,
            optimizer,
            ranks: 1 + step as usize % 2,
        }
    }

    #[test]
    fn checkpoints_round_trip_and_old_ones_are_deleted() {
        let run = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::of_run(run.path());
        assert!(matches!(checkpoints.read_last(&layout()), Err(CheckpointError::None { .. })));
        for step in 1..=6 {
            checkpoints.write(&checkpoint(step), &layout()).unwrap();
            checkpoints.prune(2, Some(2)).unwrap();
        }
        assert_eq!(checkpoints.steps().unwrap(), [2, 5, 6]);
        assert_eq!(checkpoints.read_last(&layout()).unwrap(), checkpoint(6));
        let last = srflow_nn::read_parameters(&run.path().join("last.safetensors")).unwrap();
        assert_eq!(last.keys().collect::<Vec<_>>(), ["a.running_mean", "a.weight", "b.bias"]);
    }

    fn listed(folder: &Path) -> Vec<String> {
        let mut names = names(folder).unwrap();
        names.sort();
        names
    }

    #[test]
    fn leftovers_of_a_killed_run_are_deleted() {
        let run = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::of_run(run.path());
        checkpoints.write(&checkpoint(1), &layout()).unwrap();
        let [before, beside] = [run.path(), &run.path().join(FOLDER)].map(listed);
        let unfinished = run.path().join(FOLDER).join(".step-00000002.partial");
        fs::create_dir(&unfinished).unwrap();
        fs::write(unfinished.join(MODEL), "half").unwrap();
        fs::write(run.path().join(".last.safetensors.77-3.partial"), "half").unwrap();
        checkpoints.prune(3, None).unwrap();
        assert_eq!([run.path(), &run.path().join(FOLDER)].map(listed), [before, beside]);
        assert_eq!(checkpoints.read_last(&layout()).unwrap(), checkpoint(1));
    }

    #[test]
    fn a_failed_write_leaves_no_partial_files() {
        let run = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::of_run(run.path());
        checkpoints.write(&checkpoint(1), &layout()).unwrap();
        fs::write(checkpoints.path(2), "a file in the way").unwrap();
        let error = checkpoints.write(&checkpoint(2), &layout()).expect_err("a file in the way").to_string();
        assert!(error.contains("step-00000002"), "{error}");
        assert_eq!(listed(&run.path().join(FOLDER)), ["step-00000001", "step-00000002"]);
    }

    #[test]
    fn the_same_checkpoint_has_the_same_bytes() {
        let [one, two] = [0, 1].map(|_| {
            let run = tempfile::tempdir().unwrap();
            let checkpoints = Checkpoints::of_run(run.path());
            checkpoints.write(&checkpoint(1), &layout()).unwrap();
            [MODEL, OPTIMIZER, STATE, SHA256SUMS]
                .map(|name| fs::read(checkpoints.path(1).join(name)).unwrap())
        });
        assert_eq!(one, two);
    }

    #[test]
    fn a_flipped_bit_is_an_error_that_names_the_checkpoint_before() {
        let run = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::of_run(run.path());
        checkpoints.write(&checkpoint(1), &layout()).unwrap();
        for step in 2..=3 {
            checkpoints.write(&checkpoint(step), &layout()).unwrap();
            for name in [MODEL, OPTIMIZER, STATE, SHA256SUMS] {
                let path = checkpoints.path(step).join(name);
                let whole = fs::read(&path).unwrap();
                for place in (0..whole.len()).step_by(7) {
                    let mut flipped = whole.clone();
                    flipped[place] ^= 1 << (place % 8);
                    fs::write(&path, &flipped).unwrap();
                    let message = checkpoints.read_last(&layout()).unwrap_err().to_string();
                    assert!(message.starts_with(&checkpoints.path(step).display().to_string()), "{message}");
                    let before = format!("continue from {}", checkpoints.path(step - 1).display());
                    assert!(message.ends_with(&before), "{message}");
                }
                fs::write(&path, &whole).unwrap();
            }
        }
        assert_eq!(checkpoints.read_last(&layout()).unwrap(), checkpoint(3));
    }

    #[test]
    fn checkpoints_of_earlier_versions_have_no_hashes() {
        let run = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::of_run(run.path());
        checkpoints.write(&checkpoint(1), &layout()).unwrap();
        fs::remove_file(checkpoints.path(1).join(SHA256SUMS)).unwrap();
        assert_eq!(checkpoints.read_last(&layout()).unwrap(), checkpoint(1));
    }

    #[test]
    fn broken_checkpoints_are_errors_that_name_the_file() {
        let run = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::of_run(run.path());
        checkpoints.write(&checkpoint(1), &layout()).unwrap();
        for name in [MODEL, OPTIMIZER, STATE] {
            let path = checkpoints.path(1).join(name);
            let whole = fs::read(&path).unwrap();
            for len in (0..whole.len() - 2).step_by(13) {
                fs::write(&path, &whole[..len]).unwrap();
                let message = checkpoints.read_last(&layout()).expect_err("half a file").to_string();
                assert!(message.contains(name), "{message}");
            }
            fs::write(&path, &whole).unwrap();
        }
        let other = Layout::from_segments(layout().segments()[..2].to_vec());
        let message = checkpoints.read_last(&other).expect_err("another network").to_string();
        assert!(message.contains("b.bias"), "{message}");
    }
}
