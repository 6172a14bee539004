//! The folder of a training that can be resumed:
//!
//! ```text
//! config.toml   the settings
//! log.jsonl     a record per line
//! .lock         the process that trains
//! ```

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{
    FileError, JsonLines, LockError, RunLock, create_folder, read_json_lines, remove_partial, write_file,
};

/// Name of the settings in a run's folder.
pub const RUN_CONFIG: &str = "config.toml";
const LOG: &str = "log.jsonl";

/// Whether to start a new run or resume one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunMode {
    /// Start at the first step, in a folder without a run.
    New,
    /// Continue from the last checkpoint in the folder.
    Resume,
}

/// Why a run cannot use its folder.
#[derive(Debug, thiserror::Error)]
pub enum RunFolderError {
    #[error(transparent)]
    Lock(#[from] LockError),
    #[error(transparent)]
    File(#[from] FileError),
    /// A new run in the folder of another one.
    #[error(
        "{0}: this folder already contains a run{of_steps}; continue it with `resume` {0}, or choose another `out`",
        .folder.display(),
        of_steps = .steps.map_or(String::new(), |steps| format!(" of {steps} steps"))
    )]
    AnotherRun {
        folder: PathBuf,
        /// Step of its last checkpoint, where that is known.
        steps: Option<u64>,
    },
}

/// The folder of a run, locked by this process until this is dropped.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: RunLock,
}

impl RunFolder {
    /// Creates the folder if necessary, locks it, and removes the files that a killed run left unfinished in it.
    ///
    /// # Errors
    /// When it cannot be created or cleaned, or another process holds its lock.
    pub fn open(path: &Path) -> Result<Self, RunFolderError> {
        create_folder(path)?;
        let lock = RunLock::take(path)?;
        remove_partial(path, |_, _| true)?;
        Ok(Self { path: path.to_owned(), _lock: lock })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the settings of the run.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_config(&self, toml: &str) -> Result<(), FileError> {
        write_file(&self.path.join(RUN_CONFIG), toml)
    }

    /// Opens the log with the records of an earlier process that `keep` selects: those up to the checkpoint to continue from.
    ///
    /// # Errors
    /// When the file cannot be read or written, or a line is not a valid record.
    pub fn log<R: Serialize + DeserializeOwned>(
        &self,
        keep: impl Fn(&R) -> bool,
    ) -> Result<JsonLines, FileError> {
        JsonLines::open(&self.path.join(LOG), keep)
    }
}

/// Reads the log of the run in a folder.
///
/// # Errors
/// When there is no log, or a line is not a valid record.
pub fn read_run_log<R: DeserializeOwned>(run: &Path) -> Result<Vec<R>, FileError> {
    read_json_lines(&run.join(LOG))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Serialize, serde::Deserialize)]
    struct Step {
        step: u32,
    }

    #[test]
    fn a_run_has_its_folder_alone_and_continues_its_log() {
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("runs/1");
        let run = RunFolder::open(&path).unwrap();
        assert!(matches!(RunFolder::open(&path), Err(RunFolderError::Lock(LockError::Held { .. }))));
        let mut log = run.log::<Step>(|_| true).unwrap();
        (1..=3).for_each(|step| log.append(&Step { step }).unwrap());
        drop((run, log));

        std::fs::write(path.join(".log.jsonl.7-0.partial"), "half").unwrap();
        let run = RunFolder::open(&path).unwrap();
        assert!(!path.join(".log.jsonl.7-0.partial").exists());
        run.log(|record: &Step| record.step <= 2).unwrap();
        let steps: Vec<u32> = read_run_log::<Step>(&path).unwrap().iter().map(|record| record.step).collect();
        assert_eq!(steps, [1, 2]);
    }

    #[test]
    fn another_run_is_named_with_its_steps() {
        let error = |steps| RunFolderError::AnotherRun { folder: "runs/1".into(), steps }.to_string();
        assert!(error(None).starts_with("runs/1: this folder already contains a run; continue it"));
        assert!(error(Some(9)).contains("contains a run of 9 steps; continue it with `resume` runs/1"));
    }
}
