//! The lock that admits one process at a time to a run's folder.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::{FileError, FileProblem};

/// Name of the lock in a run's folder.
const LOCK: &str = ".lock";
/// Most bytes read from a lock file.
const NOTE_BYTES: u64 = 200;

/// A file lock on a run's folder. The system releases it however the process ends, so a file left by a process that died does
/// not block the next one.
#[derive(Debug)]
pub struct RunLock {
    file: File,
}

/// Errors of locking a run's folder.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    #[error(
        "{}: another process is writing into this folder: {holder}; wait until it finishes, stop it, or choose another folder",
        .folder.display()
    )]
    Held {
        folder: PathBuf,
        /// Process and host from the lock file, and how long ago it took the lock.
        holder: String,
    },
    #[error(transparent)]
    File(#[from] FileError),
}

impl RunLock {
    /// Locks the run in `folder`, which must exist.
    ///
    /// # Errors
    /// When another process holds the lock, or its file cannot be created.
    pub fn take(folder: &Path) -> Result<Self, LockError> {
        Self::named(folder, LOCK)
    }

    /// Locks one part of the work in `folder`, such as `1-of-4`, beside which other processes do the other parts.
    ///
    /// # Errors
    /// Those of [`Self::take`].
    pub fn take_part(folder: &Path, part: &str) -> Result<Self, LockError> {
        Self::named(folder, &format!("{LOCK}-{part}"))
    }

    /// Locks all parts of the work in `folder` that were ever begun, and the whole.
    ///
    /// # Errors
    /// Those of [`Self::take`], for any of them.
    pub fn take_all(folder: &Path) -> Result<Vec<Self>, LockError> {
        let failed = |error| FileProblem::Io { doing: "listing the folder", error }.in_file(folder);
        let mut locks = vec![Self::take(folder)?];
        for entry in std::fs::read_dir(folder).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            if let Some(name) = name.to_str().filter(|name| name.starts_with(LOCK) && *name != LOCK) {
                locks.push(Self::named(folder, name)?);
            }
        }
        Ok(locks)
    }

    fn named(folder: &Path, name: &str) -> Result<Self, LockError> {
        let path = folder.join(name);
        let failed = |error| FileProblem::Io { doing: "locking the file", error }.in_file(&path);
        let options = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = options.map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let holder = read_note(&file).unwrap_or_else(|| "an unknown process".to_owned());
                return Err(LockError::Held { folder: folder.to_owned(), holder });
            }
            // The file system has no locks: a run without protection is better than none.
            Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(error)) => return Err(failed(error).into()),
        }
        // The note only informs users; on a full disk the lock works without it.
        let _ = file.set_len(0).and_then(|()| file.write_all(note().as_bytes()));
        Ok(Self { file })
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        let _ = self.file.set_len(0); // a stale note would be misleading
    }
}

fn note() -> String {
    let host = sysinfo::System::host_name().unwrap_or_else(|| "an unknown host".to_owned());
    format!("process {} on {host}\n", std::process::id())
}

/// Who holds the lock, and for how long, judging by the time of the note.
fn read_note(mut file: &File) -> Option<String> {
    let held = file.metadata().ok()?.modified().ok()?.elapsed().unwrap_or_default();
    let mut note = String::new();
    file.rewind().ok()?;
    file.take(NOTE_BYTES).read_to_string(&mut note).ok()?;
    let holder: String = note.trim().chars().filter(|c| !c.is_control()).collect();
    (!holder.is_empty()).then(|| format!("{holder}, for {}", rough_duration(held)))
}

/// `90 s`, `12 min`, `5 h`.
fn rough_duration(time: Duration) -> String {
    match time.as_secs() {
        seconds @ ..120 => format!("{seconds} s"),
        seconds @ ..7200 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_names_the_holder_and_a_stale_lock_is_taken_over() {
        let folder = tempfile::tempdir().unwrap();
        let lock = RunLock::take(folder.path()).unwrap();
        let error = RunLock::take(folder.path()).expect_err("held").to_string();
        assert!(error.contains(&format!("process {} on ", std::process::id())), "{error}");
        assert!(error.contains("choose another folder"), "{error}");
        drop(lock);
        // A process that died leaves a note, but no lock.
        std::fs::write(folder.path().join(LOCK), "process 1 on elsewhere\n").unwrap();
        RunLock::take(folder.path()).unwrap();
    }

    #[test]
    fn parts_are_locked_beside_each_other_but_not_beside_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let parts = ["1-of-2", "2-of-2"].map(|part| RunLock::take_part(folder.path(), part).unwrap());
        assert!(matches!(RunLock::take_part(folder.path(), "2-of-2"), Err(LockError::Held { .. })));
        assert!(matches!(RunLock::take_all(folder.path()), Err(LockError::Held { .. })));
        drop(parts);
        assert_eq!(RunLock::take_all(folder.path()).unwrap().len(), 3);
    }
}
