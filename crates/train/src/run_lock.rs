//! One process at a time in a run's folder.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Name of the lock in a run's folder.
const LOCK: &str = ".lock";
/// Longest note that is read from a lock.
const NOTE_BYTES: u64 = 200;

/// Holds a run's folder until it is dropped or the process ends, however it ends: the system releases the lock, and what
/// lies there of a process that died is taken over.
#[derive(Debug)]
pub(crate) struct RunLock {
    file: File,
}

/// Why the folder was not locked.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    #[error(
        "{}: another process trains here: {holder}; wait until it has finished, stop it, or choose another folder",
        .folder.display()
    )]
    Held {
        folder: PathBuf,
        /// Its process and host, as it wrote them, and for how long.
        holder: String,
    },
    #[error("{}: locking: {error}", .path.display())]
    Io { path: PathBuf, error: io::Error },
}

impl RunLock {
    /// Locks the run in `folder`, which must exist.
    pub(crate) fn take(folder: &Path) -> Result<Self, LockError> {
        let path = folder.join(LOCK);
        let failed = |error| LockError::Io { path: path.clone(), error };
        let options = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = options.map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let holder = read_note(&file).unwrap_or_else(|| "it left no note of itself".to_owned());
                return Err(LockError::Held { folder: folder.to_owned(), holder });
            }
            // A file system without locks: nothing keeps two processes apart there.
            Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {}
            Err(TryLockError::Error(error)) => return Err(failed(error)),
        }
        // The note is for people: on a full disk the lock holds without it.
        let _ = file.set_len(0).and_then(|()| file.write_all(note().as_bytes()));
        Ok(Self { file })
    }
}

impl Drop for RunLock {
    fn drop(&mut self) {
        let _ = self.file.set_len(0); // nobody holds it: the note would mislead
    }
}

fn note() -> String {
    let host = sysinfo::System::host_name().unwrap_or_else(|| "an unknown host".to_owned());
    format!("process {} on {host}\n", std::process::id())
}

/// Who holds the lock, and for how long: the note is written when the lock is taken.
fn read_note(mut file: &File) -> Option<String> {
    let held = file.metadata().ok()?.modified().ok()?.elapsed().unwrap_or_default();
    let mut note = String::new();
    file.rewind().ok()?;
    file.take(NOTE_BYTES).read_to_string(&mut note).ok()?;
    let holder: String = note.trim().chars().filter(|c| !c.is_control()).collect();
    (!holder.is_empty()).then(|| format!("{holder}, for {}", roughly(held)))
}

/// `90 s`, `12 min`, `5 h`.
fn roughly(time: Duration) -> String {
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
    fn a_held_folder_names_its_holder_and_a_left_one_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let lock = RunLock::take(folder.path()).unwrap();
        let error = RunLock::take(folder.path()).expect_err("held").to_string();
        assert!(error.contains(&format!("process {} on ", std::process::id())), "{error}");
        assert!(error.contains("choose another folder"), "{error}");
        drop(lock);
        // As a process that died leaves it: a note, and no lock.
        std::fs::write(folder.path().join(LOCK), "process 1 on elsewhere\n").unwrap();
        RunLock::take(folder.path()).unwrap();
    }
}
